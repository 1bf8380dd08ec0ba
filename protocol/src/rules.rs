//! The rules of the protocol that have variants.
//!
//! The default of each rule is the reading of the paper that was decided on. The other variants are literal or naive
//! readings, for which the model checker finds a shortest counterexample. Cells run [`Rules::DEFAULT`], or [`Rules::PAPER`]
//! on request.

use serde::{Deserialize, Serialize};

/// The members of a rendezvous that send CONFIRM. §4.3 can be read in three ways; a fourth is to send none (D1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Confirmation {
    /// No member sends CONFIRM.
    None,
    /// A member sends CONFIRM if it holds all arrivals before it hears of another member that does.
    FirstComplete,
    /// Every member that holds all arrivals sends CONFIRM, even if a CONFIRM has already released that member.
    EveryComplete,
    /// Every released member sends CONFIRM, whether all arrivals or a CONFIRM released it.
    PassOn,
}

/// The form in which a packet carries its time (§5.1, D37).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum TimeStamp {
    /// The packet carries the remaining time.
    Remaining,
    /// The packet carries an instant on the sender's clock, which the receiver compares with its own. This is wrong without
    /// a global clock.
    Absolute,
}

/// How long a receiver keeps the dedup entry of a class-2 message (D6, D52).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Memory {
    /// The entry is kept for the TTL and the link delay, until no copy can arrive any more.
    TtlAndLink,
    /// The entry is kept until the message is answered.
    UntilAnswered,
    /// No entry is kept.
    None,
}

/// The effect of a rejection by rank on a message, besides the port's time penalty (§5.1.1, D4, D58).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Aging {
    /// Each rejection raises the message by one rank. A port that was bypassed too often is served first.
    Bounded,
    /// A rejection has no effect, so a message may be rejected and bypassed for ever.
    Off,
    /// A port that was bypassed too often is served first, but rejections do not count.
    Unbounded,
}

/// The message that a full transit buffer evicts (D60).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Eviction {
    /// Evict status messages before commands, the least urgent status first.
    ByClass,
    /// Evict the least urgent message, whatever its class.
    ByTime,
}

/// How the primary of a couple renews its lease (D30, D61).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum LeaseRule {
    /// The primary renews its lease by heartbeats that echo one of its answers. The lease counts from the sending of that
    /// answer.
    Echoed,
    /// The primary renews its lease by any heartbeat. The lease counts from the arrival of that heartbeat.
    Heartbeat,
}

/// How the Timer accepts a task's job (Figure 3, D22).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum JobRequest {
    /// The Timer accepts a job at any time: JOB_REQUEST is a standing offer.
    Standing,
    /// The Timer waits for every busy task before the Timer counts on.
    Blocking,
}

/// One choice for each rule that has variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rules {
    /// Which members confirm a rendezvous (D1).
    pub confirmation: Confirmation,
    /// Whether meetings are numbered (D3).
    pub rounds: bool,
    /// Whether a member joins a fresher round that it hears of. If not, the member only counts its own attempts (D54).
    pub join_fresher: bool,
    /// Whether an ARRIVE carries the round from which its sender was last released (D54).
    pub last_released: bool,
    /// Whether a late ARRIVE is answered: by CONFIRM if its round is the one from which the receiver was last released, by
    /// ABORT if the round is older. If not, the receiver drops it, as in the literal reading of §4.3 (D54, D55).
    pub answer_late_arrivals: bool,
    /// Whether a member that gives up sends ABORT, so that the others go on in a fresher round (D2, D54).
    pub aborts: bool,
    /// Whether the time that a message spends in a buffer is subtracted from its TTL (§5.1.1).
    pub charge_residence: bool,
    /// Whether the sender drops a reply that comes after the time_out of its request (§4.1).
    pub refuse_late_replies: bool,
    /// Whether the link delay of the reply is subtracted from the receiver's execution budget (D18).
    pub reserve_way_back: bool,
    /// The form in which a packet carries its time (D37).
    pub time_stamp: TimeStamp,
    /// How long class-2 messages are remembered, to recognise copies (D6).
    pub memory: Memory,
    /// Whether a restarted task refuses commands and arrivals that may be meant for its earlier incarnation (D49).
    pub quarantine: bool,
    /// The effect of a rejection on a message (D58).
    pub aging: Aging,
    /// Whether a handler runs only if it outranks the running activation (R16).
    pub obey_order: bool,
    /// The message that a full transit buffer evicts (D60).
    pub eviction: Eviction,
    /// How a primary renews its lease (D61).
    pub lease: LeaseRule,
    /// Whether an actuator drops commands of an older epoch than the newest one that it has heard of (D61).
    pub heed_epochs: bool,
    /// How the Timer accepts a job (D22).
    pub job_request: JobRequest,
}

impl Rules {
    /// The rules that the runtime uses, and for which the claims hold.
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
        memory: Memory::TtlAndLink,
        quarantine: true,
        aging: Aging::Bounded,
        obey_order: true,
        eviction: Eviction::ByClass,
        lease: LeaseRule::Echoed,
        heed_epochs: true,
        job_request: JobRequest::Standing,
    };

    /// The paper's own rules, where they differ from the decisions. Meetings have no rounds, and late arrivals are not answered
    /// (§4.3). A receiver may use all the remaining time (§4.1). A rejection has no effect but the port's penalty (§5.1.1).
    /// Where the paper says nothing, the decisions hold.
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
