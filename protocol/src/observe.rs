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
    /// The message's remaining time ended in a task's buffer.
    Expired,
    /// The message's remaining time ended on a link or in a kernel queue.
    ExpiredOnTheWay,
    /// The message's remaining time ended in the transit buffer, or would end on the route ahead.
    ExpiredInTransit,
    /// The buffer was full, and no message in it had to make room for this one.
    Refused,
    /// The message was removed from a full buffer, to make room for a more urgent one.
    Evicted,
    /// The message is a copy of one that was received before.
    Duplicate,
    /// The packet belongs to a meeting that is over.
    OldRound,
    /// The message's source may not use its port this way, or it came from the wrong neighbour.
    NotAllowed,
    /// The message is for a task that this node neither runs nor can reach.
    Unroutable,
    /// The packet has passed too many relays.
    HopLimit,
    /// The packet answers a request that is no longer outstanding.
    Unexpected,
    /// The packet comes from, or may be meant for, an earlier incarnation of a node.
    StaleIncarnation,
    /// A newer message of the same source replaced the message.
    Superseded,
    /// Fragments of the message are missing (D28).
    Incomplete,
    /// The message was sent under a lease that has passed to another task (D61).
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

    /// A short name of the reason, for tables and counters.
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
    /// The task reached a `waitfor` (rendezvous).
    Reached,
    /// The task moved on to a fresher round while waiting.
    Rejoined,
    /// The task heard that another member has arrived at the rendezvous.
    PartnerArrived,
    /// Another member gave up the rendezvous.
    PartnerAborted,
    /// The task sent CONFIRM: all members have reached the rendezvous.
    Confirmed,
    /// The task was released because it held all arrivals.
    ReleasedComplete,
    /// The task was released by a CONFIRM.
    ReleasedByConfirm,
    /// All members had arrived, but with too little time left to release (D2).
    WithinMargin,
    /// The task gave up a rendezvous.
    GaveUp,
    /// A message for a handler did not outrank the running activation (R16).
    Rejected,
    /// A handler began, and the running activation was suspended (R16).
    Interrupted,
    /// A handler ended.
    Resumed,
    /// The task, a primary or standby, got the lease under which it may act (D61).
    Granted,
    /// The task took over from its partner.
    TookOver,
    /// The task lost its lease.
    Fenced,
}

/// One observation. The event decides what `number` means: a message's sequence, a meeting's round, the id of the timer
/// whose handler began, how many handlers still run after one ended, or the epoch of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Observation {
    /// What happened.
    pub event: Event,
    /// The port on which the event happened; [`PortId::NONE`] for the end of a timer and of a handler.
    pub port: PortId,
    /// The other task that was involved; at the end of a timer or of a handler, the task itself.
    pub peer: TaskId,
    /// The number that belongs to the event; see [`Observation`].
    pub number: u32,
    /// The remaining time of the message or of the wait.
    pub remaining: Ticks,
}

impl Observation {
    /// The observation of an event about a message, or about a packet of it.
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
    /// Messages that the task sent, or rendezvous that it reached, without retransmitted copies.
    pub sent: u64,
    /// Copies that were retransmitted.
    pub resent: u64,
    /// Messages put into the buffer, or handed over at once.
    pub enqueued: u64,
    /// Messages handed to the task, or rendezvous from which it was released.
    pub delivered: u64,
    /// Messages whose remaining time ended at this task.
    pub expired: u64,
    /// Messages that were refused, because there was no space.
    pub refused: u64,
    /// Messages that the task rejected by rank.
    pub rejected: u64,
    /// Messages that were removed to make room for more urgent ones.
    pub evicted: u64,
    /// Copies of messages that were received before.
    pub duplicates: u64,
    /// Requests of the task itself that ended by time_out.
    pub timed_out: u64,
    /// Other drops: old rounds, not allowed, unexpected.
    pub dropped: u64,
}

/// What a task is doing, as its communication task knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum TaskState {
    /// The task runs: it has no outstanding request.
    Running,
    /// The task waits for a message.
    Receiving {
        /// The port on which it waits; `None` if it waits on any.
        port: Option<PortId>,
        /// The remaining time of the wait; `None` if it waits without end.
        remaining: Option<Ticks>,
    },
    /// The task waits for the answer to its class-2 message.
    AwaitingReply {
        /// The port of the message.
        port: PortId,
        /// The recipient from which the answer must come.
        from: TaskId,
        /// The remaining time of the message.
        remaining: Ticks,
    },
    /// The task waits for the other members at a rendezvous.
    Waiting {
        /// The port of the rendezvous.
        port: PortId,
        /// The round in which the task waits.
        round: Round,
        /// The remaining time of the wait.
        remaining: Ticks,
    },
    /// The task waits in a `delay`.
    Delaying,
}

/// A waiting message, as a monitor shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QueueEntry {
    /// The task that sent the message.
    pub source: TaskId,
    /// The message's id.
    pub id: MessageId,
    /// The message's class.
    pub class: Class,
    /// The message's remaining time.
    pub remaining: Ticks,
}

/// A port of one task.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PortView {
    /// The port that the view shows.
    pub port: PortId,
    /// What the task does with the port.
    pub usage: Usage,
    /// The port's class.
    pub class: Class,
    /// How many messages wait on the port.
    pub len: u16,
    /// How many messages may wait; zero if this end receives nothing.
    pub capacity: u16,
    /// The remaining time of the most urgent waiting message.
    pub min_slack: Option<Ticks>,
    /// The waiting messages in the order in which they will be served, at most as many as the monitor asked for.
    pub queue: Vec<QueueEntry>,
    /// The counters of the port.
    pub counters: PortCounters,
}

/// A waiting message with its rejections. Its remaining time, its urgency and the time of its next offer are three
/// separate things (D4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HeldView {
    /// The waiting message.
    pub entry: QueueEntry,
    /// The message's arrival number among all messages that the task stored: a lower one arrived earlier. In a task that was
    /// read from packed bytes, only the numbers of messages of one source and port can be compared.
    pub arrival: u64,
    /// How many packets the message takes (D28).
    pub fragments: u8,
    /// On a port with a handler, the rank of the message: the rank that the task's `order` gives, less the rejections. Zero
    /// is the most urgent.
    pub rank: Option<u8>,
    /// How often the message was rejected by rank, as far as rejections count (D58).
    pub rejections: u8,
    /// Whether the message was rejected so often that it outranks the task's own thread (D58).
    pub capped: bool,
    /// How long until the message is offered again: its penalty.
    pub back_off: Ticks,
}

/// The queue of a port, in the detail that a monitor shows for a watched port.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QueueView {
    /// Whether the task has a handler for the port's messages.
    pub handled: bool,
    /// How often other ports were served while this port had a message to serve (D58).
    pub bypassed: u16,
    /// How often other ports may be served before this port goes first (D58).
    pub bypass_limit: u16,
    /// The waiting messages in the order of their remaining times, at most as many as the monitor asked for.
    pub queue: Vec<HeldView>,
}

/// The state of one task in a rendezvous.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum MeetingState {
    /// The task has not reached the rendezvous.
    Away,
    /// The task waits for the other members.
    Gathering,
    /// The task holds every arrival, but too little time is left to release; only a CONFIRM can release it (D2).
    WithinMargin,
}

/// What one task knows of one member of a rendezvous.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MemberView {
    /// The member that the task knows of.
    pub task: TaskId,
    /// Whether the member has arrived in the round that is shown.
    pub arrived: bool,
    /// Whether the member is known to have been released from that round.
    pub confirmed: bool,
    /// The member's remaining patience, if it has arrived.
    pub remaining: Option<Ticks>,
}

/// A rendezvous as one task sees it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MeetingView {
    /// The port of the rendezvous.
    pub port: PortId,
    /// The round in which the task waits, or the next one in which it will.
    pub round: Round,
    /// The last round from which this task was released.
    pub released: Round,
    /// The state of this task in the rendezvous.
    pub state: MeetingState,
    /// The remaining patience of this task, if it waits.
    pub remaining: Option<Ticks>,
    /// All members, the owner first; this task is among them.
    pub members: Vec<MemberView>,
}

/// A task and its communication task at one instant.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TaskView {
    /// The task that the view shows.
    pub task: TaskId,
    /// What the task is doing.
    pub state: TaskState,
    /// The task's ports, ascending.
    pub ports: Vec<PortView>,
    /// The task's rendezvous, ascending by port.
    pub meetings: Vec<MeetingView>,
}

/// The transit buffer of a node at one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TransitView {
    /// How many packets wait in the buffer.
    pub len: u16,
    /// How many packets may wait in the buffer.
    pub capacity: u16,
    /// The remaining time of the most urgent waiting packet.
    pub min_slack: Option<Ticks>,
    /// Packets relayed or sent since the node started.
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
