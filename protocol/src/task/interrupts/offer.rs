//! Candidates for interrupting the running activation, in the order of service (D16, D58).

use crate::ids::PortId;
use crate::packet::Class;
use crate::queue::Slot;
use crate::ticks::Instant;

/// A candidate for interrupting the running activation. The candidate with the least key goes first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Offer {
    pub key: (Turn, u8, Instant, Class, PortId, u64),
    pub what: What,
}

/// The first part of the key of an offer, which counts before rank and urgency.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Turn {
    /// The task has lost its lease, or takes over from its partner (D61).
    Lease,
    /// A capped message: ranks stand above it, and it was rejected once for each of them. Of several capped messages, the
    /// one that was rejected first goes first (D58).
    Capped(u64),
    /// A message of a port that was bypassed too often. The port with the most bypasses goes first, so the count is
    /// inverted.
    Bypassed(u16),
    InOrder,
    /// A capped message right after another one. Messages that outrank the running activation by their own rank go before
    /// it, because otherwise a flood of rejected messages would starve the first rank (D76).
    CappedAgain(u64),
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum What {
    Lease,
    Timer(usize),
    /// A message: the position of its inbox, and its slot in that inbox.
    Message(usize, Slot),
}

impl Offer {
    /// The offer of the lease's pending call, which outranks everything.
    pub const LEASE: Self =
        Self { key: (Turn::Lease, 0, Instant::START, Class::Command, PortId(0), 0), what: What::Lease };
}

/// The cap: after this many rejections a message of this rank outranks the task's own thread (D58).
pub(crate) const fn cap(rank: u8) -> u8 {
    if rank == 0 { 1 } else { rank }
}
