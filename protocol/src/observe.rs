//! Observation of a node: the events that it reports while it runs, and views of its state. The monitor, the recorder and
//! the checkers see a node only through these types.

use crate::cell::Usage;
use crate::ids::{MessageId, NodeId, PortId, Round, TaskId};
use crate::packet::Class;
use crate::ticks::Ticks;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Why a message was dropped. Every drop has a reason, is counted and is visible (D19).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Reason {
    /// Its remaining time ended in a task's buffer.
    Expired,
    /// Its remaining time ended on a link or in a kernel queue.
    ExpiredOnTheWay,
    /// Its remaining time ended in the transit buffer, or would end on the route ahead.
    ExpiredInTransit,
    /// The buffer was full, and no message in it had to make room.
    Refused,
    /// It made room for a more urgent message.
    Evicted,
    /// It is a copy of a message that was received before.
    Duplicate,
    /// It belongs to a meeting that is over.
    OldRound,
    /// Its source may not use its port this way, or it came from the wrong neighbour.
    NotAllowed,
    /// It is for a task that this node neither runs nor can reach.
    Unroutable,
    /// It has passed too many relays.
    HopLimit,
    /// It answers a request that is not outstanding any more.
    Unexpected,
    /// It comes from, or may be meant for, an earlier incarnation of a node.
    StaleIncarnation,
    /// A newer message of its source replaced it.
    Superseded,
    /// Fragments of it are missing (D28).
    Incomplete,
    /// It was sent under a lease that has passed to another task (D61).
    StaleEpoch,
}

impl Reason {
    /// All reasons, in the order of their discriminants.
    pub const ALL: [Self; 15] = [
        Self::Expired,
        Self::ExpiredOnTheWay,
        Self::ExpiredInTransit,
        Self::Refused,
        Self::Evicted,
        Self::Duplicate,
        Self::OldRound,
        Self::NotAllowed,
        Self::Unroutable,
        Self::HopLimit,
        Self::Unexpected,
        Self::StaleIncarnation,
        Self::Superseded,
        Self::Incomplete,
        Self::StaleEpoch,
    ];

    /// A short name for tables and counters.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Expired => "expired",
            Self::ExpiredOnTheWay => "expired_on_the_way",
            Self::ExpiredInTransit => "expired_in_transit",
            Self::Refused => "refused",
            Self::Evicted => "evicted",
            Self::Duplicate => "duplicate",
            Self::OldRound => "old_round",
            Self::NotAllowed => "not_allowed",
            Self::Unroutable => "unroutable",
            Self::HopLimit => "hop_limit",
            Self::Unexpected => "unexpected",
            Self::StaleIncarnation => "stale_incarnation",
            Self::Superseded => "superseded",
            Self::Incomplete => "incomplete",
            Self::StaleEpoch => "stale_epoch",
        }
    }
}

/// Something that happened in a communication task or the transit buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Event {
    /// The task's message was handed to the route layer.
    Sent,
    /// A copy of the task's message was retransmitted.
    Resent,
    /// A message was put into a port's buffer.
    Enqueued,
    /// A message was handed to the task.
    Delivered,
    /// The task answered a message.
    Replied,
    /// The task's class-2 message was answered.
    Answered,
    /// The task's class-2 message was refused.
    RefusedByPeer,
    /// The time_out of the task's class-2 message ended; the receiver may have carried it out.
    TimedOut,
    /// The time_out of the task's class-2 message ended before any copy left.
    TimedOutUnsent,
    /// The peer of the task's class-2 message restarted.
    PeerRestarted,
    /// A message was dropped.
    Discarded(Reason),
    /// The task reached a waitfor.
    Reached,
    /// The task moved on to a fresher round while waiting.
    Rejoined,
    /// A partner's arrival came in.
    PartnerArrived,
    /// A partner gave up.
    PartnerAborted,
    /// A CONFIRM was sent.
    Confirmed,
    /// The task was released because it held all arrivals.
    ReleasedComplete,
    /// The task was released by a CONFIRM.
    ReleasedByConfirm,
    /// All had arrived, but with too little time left to release (D2).
    WithinMargin,
    /// The task gave up a waitfor.
    GaveUp,
    /// A message for a handler did not outrank the running activation (R16).
    Rejected,
    /// A handler began, and the running activation was suspended (R16).
    Interrupted,
    /// A handler ended.
    Resumed,
    /// The task holds the lease of its couple (D61).
    Granted,
    /// The task took over from its partner.
    TookOver,
    /// The task lost its lease.
    Fenced,
}

/// One observation. The event decides what `number` means: a message's sequence, a meeting's round, the name of the timer
/// whose handler began, how many handlers still run after one ended, or the epoch of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Observation {
    /// What happened.
    pub event: Event,
    /// On which port; [`PortId::NONE`] for the end of a timer and of a handler.
    pub port: PortId,
    /// With which other task; at the end of a timer or of a handler, the task itself.
    pub peer: TaskId,
    /// The number that belongs to the event; see above.
    pub number: u32,
    /// The remaining time of the message or of the wait.
    pub remaining: Ticks,
}

impl Observation {
    /// What happened to a message, or to a packet of it.
    pub(crate) const fn of(
        event: Event,
        port: PortId,
        peer: TaskId,
        id: MessageId,
        remaining: Ticks,
    ) -> Self {
        Self { event, port, peer, number: id.sequence.get(), remaining }
    }
}

/// Counters of one port at one task. They only grow during an incarnation of the node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PortCounters {
    /// Messages the task sent, or waitfors it reached; retransmitted copies not counted.
    pub sent: u64,
    /// Copies retransmitted.
    pub resent: u64,
    /// Messages put into the buffer, or handed over at once.
    pub enqueued: u64,
    /// Messages handed to the task, or waitfors released.
    pub delivered: u64,
    /// Messages that expired here.
    pub expired: u64,
    /// Messages that found no space.
    pub refused: u64,
    /// Messages that the task rejected by rank.
    pub rejected: u64,
    /// Messages dropped to make room.
    pub evicted: u64,
    /// Copies of messages received before.
    pub duplicates: u64,
    /// The task's own requests that ended by time_out.
    pub timed_out: u64,
    /// Other drops: old rounds, not allowed, unexpected.
    pub dropped: u64,
}

/// What a task is doing, as its communication task knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum TaskState {
    /// It runs: it has no outstanding request.
    Running,
    /// It waits for a message.
    Receiving {
        /// On this port, or on any.
        port: Option<PortId>,
        /// The remaining time; `None` waits without end.
        remaining: Option<Ticks>,
    },
    /// It waits for the answer to its class-2 message.
    AwaitingReply {
        /// On this port.
        port: PortId,
        /// The task that sent it.
        from: TaskId,
        /// The remaining time.
        remaining: Ticks,
    },
    /// It waits for others at a waitfor.
    Waiting {
        /// On this port.
        port: PortId,
        /// The round.
        round: Round,
        /// The remaining time.
        remaining: Ticks,
    },
    /// It waits in a `delay`.
    Delaying,
}

/// A waiting message, as a monitor shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QueueEntry {
    /// Who sent it.
    pub source: TaskId,
    /// Its id.
    pub id: MessageId,
    /// Its class.
    pub class: Class,
    /// Its remaining time.
    pub remaining: Ticks,
}

/// A port of one task.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PortView {
    /// Which port.
    pub port: PortId,
    /// What the task does with it.
    pub usage: Usage,
    /// Its class.
    pub class: Class,
    /// How many messages wait.
    pub len: u16,
    /// How many may wait; zero if this end receives nothing.
    pub capacity: u16,
    /// The remaining time of the most urgent one.
    pub min_slack: Option<Ticks>,
    /// The waiting messages in the order they will be served, as many as were asked for.
    pub queue: Vec<QueueEntry>,
    /// The counters.
    pub counters: PortCounters,
}

/// A waiting message with its retry state. Its remaining time, its urgency and the time of its next offer are three
/// separate things (D4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HeldView {
    /// The message.
    pub entry: QueueEntry,
    /// Its arrival number among all messages that the task stored: a lower one arrived earlier. In a task that was read from
    /// packed bytes, only the numbers of one source and port compare.
    pub arrival: u64,
    /// How many packets it takes (D28).
    pub fragments: u8,
    /// On a port with a handler, its rank: the rank that the task's `order` gives, less the rejections. Zero is the most urgent.
    pub rank: Option<u8>,
    /// How often it was rejected by rank, as far as rejections count (D58).
    pub rejections: u8,
    /// Whether it was rejected so often that it outranks the task's own thread (D58).
    pub capped: bool,
    /// How long until it is offered again: its penalty.
    pub back_off: Ticks,
}

/// The queue of a port, in the detail that a monitor shows for a watched port.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QueueView {
    /// Whether the task has a handler for its messages.
    pub handled: bool,
    /// How often other ports were served while this one had something to offer (D58).
    pub bypassed: u16,
    /// How often this port may be bypassed at most (D58).
    pub bypass_limit: u16,
    /// The waiting messages in the order of their remaining times, as many as were asked for.
    pub queue: Vec<HeldView>,
}

/// The state of one task in a rendezvous.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum MeetingState {
    /// It has not reached the waitfor.
    Away,
    /// It waits for the others.
    Gathering,
    /// It holds every arrival, but too little time is left to release; only a CONFIRM can help (D2).
    WithinMargin,
}

/// What one task knows of one member of a rendezvous.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MemberView {
    /// Which member.
    pub task: TaskId,
    /// Whether it has arrived in the round shown.
    pub arrived: bool,
    /// Whether it is known to have released that round.
    pub confirmed: bool,
    /// Its remaining patience, if it has arrived.
    pub remaining: Option<Ticks>,
}

/// A rendezvous as one task sees it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MeetingView {
    /// The port.
    pub port: PortId,
    /// The round waited in, or the next one to wait in.
    pub round: Round,
    /// The round this task last released.
    pub released: Round,
    /// The state of this task.
    pub state: MeetingState,
    /// Its remaining patience, if it waits.
    pub remaining: Option<Ticks>,
    /// All members, owner first; the task itself included.
    pub members: Vec<MemberView>,
}

/// A task and its communication task at one instant.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TaskView {
    /// Which task.
    pub task: TaskId,
    /// What it is doing.
    pub state: TaskState,
    /// Its ports, ascending.
    pub ports: Vec<PortView>,
    /// Its waitfors, ascending by port.
    pub meetings: Vec<MeetingView>,
}

/// The transit buffer of a node at one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TransitView {
    /// How many packets wait.
    pub len: u16,
    /// How many may wait.
    pub capacity: u16,
    /// The remaining time of the most urgent one.
    pub min_slack: Option<Ticks>,
    /// Packets relayed or sent since the start.
    pub forwarded: u64,
    /// Packets dropped, by [`Reason::ALL`] position.
    pub discarded: Vec<u64>,
    /// The succeeding nodes for which packets wait.
    pub next: Vec<NodeId>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeSet;

    #[test]
    fn all_reasons_stand_at_their_discriminants_under_names_of_their_own() {
        for (i, reason) in Reason::ALL.into_iter().enumerate() {
            assert_eq!(reason as usize, i);
        }
        let names: BTreeSet<_> = Reason::ALL.iter().map(|reason| reason.name()).collect();
        assert_eq!(names.len(), Reason::ALL.len());
    }
}
