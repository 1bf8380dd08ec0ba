//! What may interrupt the thread that runs, in the order of service (D16, D58).

use crate::ids::PortId;
use crate::packet::Class;
use crate::queue::Slot;
use crate::ticks::Instant;

/// Something that may interrupt the current thread, in the order of service: the lesser key first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Offer {
    pub key: (Turn, u8, Instant, Class, PortId, u128),
    pub what: What,
}

/// What goes first whatever its rank and urgency.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Turn {
    /// The task lost its lease, or takes over (D61).
    Lease,
    /// It was rejected as often as ranks stand above it: the one that was rejected first (D58).
    Capped(u64),
    /// Its port was passed over too often: the one passed over most, counted down.
    Bypassed(u16),
    InOrder,
    /// It is at its cap, but so was the one before: what outranks by itself comes between, or a flood of rejected messages
    /// would keep the first rank from its turn.
    CappedAgain(u64),
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum What {
    Lease,
    Timer(usize),
    /// A message: its inbox, and where it waits there.
    Message(usize, Slot),
}

impl Offer {
    /// Word of the lease: it outranks everything.
    pub const LEASE: Self =
        Self { key: (Turn::Lease, 0, Instant::START, Class::Command, PortId(0), 0), what: What::Lease };
}

/// How many rejections make a message of this rank outrank the task's own thread (D58).
pub(crate) const fn cap(rank: u8) -> u8 {
    if rank == 0 { 1 } else { rank }
}
