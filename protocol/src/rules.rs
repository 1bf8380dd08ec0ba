//! The named variants of the protocol's rules.
//!
//! The default of each is the decision taken; the others are the literal or naive readings that the model checker
//! shows the shortest counterexample of. Cells run [`Rules::DEFAULT`], or [`Rules::PAPER`] where that is asked for.

use serde::{Deserialize, Serialize};

/// Who sends a CONFIRM (D1). §4.3 can be read in three ways, and a fourth is to send none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Confirmation {
    /// Nobody.
    None,
    /// A task that completes its arrivals before it heard of any other that did.
    FirstComplete,
    /// Every task that holds all arrivals, even one that a CONFIRM has released already.
    EveryComplete,
    /// Every released task, whatever released it.
    PassOn,
}

/// How a message's time travels (§5.1, D37).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum TimeStamp {
    /// As the time that remains.
    Remaining,
    /// As an instant on the sender's clock, which the receiver compares with its own: wrong without a global clock.
    Absolute,
}

/// How long a receiver remembers which class-2 messages it has taken (D6, D52).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Memory {
    /// For the message's life and the link bound.
    LifeAndLink,
    /// Until it is answered.
    UntilAnswered,
    /// Not at all.
    None,
}

/// What a rejection by rank does to a message, besides the port's time penalty (§5.1.1, D4, D58).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Aging {
    /// Each rejection raises its rank by one level, and heads that were bypassed too often go first.
    Bounded,
    /// Nothing: it may be rejected and bypassed for ever.
    Off,
    /// Heads that were bypassed too often go first, but rejections do not count.
    Unbounded,
}

/// Which message makes room in a full buffer (D60).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Eviction {
    /// What is useless, then statuses, then by time.
    ByClass,
    /// The one with most time left, whatever its class.
    ByTime,
}

/// How the primary of a couple keeps its lease (D30, D61).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum LeaseRule {
    /// By beats that echo its last answer, from when it sent that.
    Echoed,
    /// By any beat, from when it came.
    Heartbeat,
}

/// How the Timer takes a task's job (Figure 3, D22).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum JobRequest {
    /// JOB_REQUEST is a standing offer.
    Standing,
    /// The Timer waits for each task's answer before it counts on.
    Blocking,
}

/// One choice for each rule that has variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rules {
    /// Who confirms a rendezvous (D1).
    pub confirmation: Confirmation,
    /// Whether meetings are numbered (D3).
    pub rounds: bool,
    /// Whether a task goes on to a fresher round that it hears of; off, it only counts its own attempts (D54).
    pub join_fresher: bool,
    /// Whether an ARRIVE says which round its sender last released (D54).
    pub last_released: bool,
    /// Whether a late ARRIVE of a released round is answered with a CONFIRM and one of an older round with an ABORT
    /// (D54, D55). Off, every packet is sent once: the literal reading of §4.3.
    pub answer_late_arrivals: bool,
    /// Whether a member that gave up says so, and its partners go on in a fresher round (D2, D54).
    pub aborts: bool,
    /// Whether time spent in a buffer is taken from a message's life (§5.1.1).
    pub charge_residence: bool,
    /// Whether the sender refuses a reply that comes after its time_out (§4.1).
    pub refuse_late_replies: bool,
    /// Whether the way back is taken from the receiver's execution budget (D18).
    pub reserve_way_back: bool,
    /// How a message's time travels (D37).
    pub time_stamp: TimeStamp,
    /// How long class-2 messages are remembered (D6).
    pub memory: Memory,
    /// Whether a restarted task turns commands away while copies of what its earlier life ran may live (D49).
    pub quarantine: bool,
    /// What a rejection does to a message (D58).
    pub aging: Aging,
    /// Whether a handler runs only when it outranks the current thread (R16).
    pub obey_order: bool,
    /// Which message makes room in a full buffer (D60).
    pub eviction: Eviction,
    /// How a primary keeps its lease (D61).
    pub lease: LeaseRule,
    /// Whether an actuator drops commands of an older epoch than the newest it heard of (D61).
    pub heed_epochs: bool,
    /// How the Timer takes a job (D22).
    pub job_request: JobRequest,
}

impl Rules {
    /// The rules that the runtime runs and the claims hold for.
    pub const DEFAULT: Self = Self {
        confirmation: Confirmation::EveryComplete,
        rounds: true,
        join_fresher: true,
        last_released: true,
        answer_late_arrivals: true,
        aborts: true,
        charge_residence: true,
        refuse_late_replies: true,
        reserve_way_back: true,
        time_stamp: TimeStamp::Remaining,
        memory: Memory::LifeAndLink,
        quarantine: true,
        aging: Aging::Bounded,
        obey_order: true,
        eviction: Eviction::ByClass,
        lease: LeaseRule::Echoed,
        heed_epochs: true,
        job_request: JobRequest::Standing,
    };

    /// The paper's own rules, where they differ from the decisions: meetings have no rounds and every packet of them is
    /// sent once (§4.3), a receiver may use up all the time that is left (§4.1), and a rejection does nothing to a message
    /// but what its port's penalty says (§5.1.1). Where the paper says nothing, the decisions stay.
    pub const PAPER: Self = Self {
        rounds: false,
        join_fresher: false,
        last_released: false,
        answer_late_arrivals: false,
        aborts: false,
        reserve_way_back: false,
        aging: Aging::Off,
        ..Self::DEFAULT
    };
}

impl Default for Rules {
    fn default() -> Self {
        Self::DEFAULT
    }
}
