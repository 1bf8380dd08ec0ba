//! Coverage: which transitions of the state machine the monitor has observed, out of all that exist.

use imrs_protocol::{Class, Event, Reason, TaskView, Usage};

/// All kinds of observations, in the order of display.
pub const KINDS: [Event; 40] = [
    Event::Sent,
    Event::Resent,
    Event::Enqueued,
    Event::Delivered,
    Event::Replied,
    Event::Answered,
    Event::RefusedByPeer,
    Event::TimedOut,
    Event::TimedOutUnsent,
    Event::PeerRestarted,
    Event::Reached,
    Event::Rejoined,
    Event::PartnerArrived,
    Event::PartnerAborted,
    Event::Confirmed,
    Event::ReleasedComplete,
    Event::ReleasedByConfirm,
    Event::WithinMargin,
    Event::GaveUp,
    Event::Rejected,
    Event::Interrupted,
    Event::Resumed,
    Event::Granted,
    Event::TookOver,
    Event::Fenced,
    Event::Discarded(Reason::Expired),
    Event::Discarded(Reason::ExpiredOnTheWay),
    Event::Discarded(Reason::ExpiredInTransit),
    Event::Discarded(Reason::Refused),
    Event::Discarded(Reason::Evicted),
    Event::Discarded(Reason::Duplicate),
    Event::Discarded(Reason::OldRound),
    Event::Discarded(Reason::NotAllowed),
    Event::Discarded(Reason::Unroutable),
    Event::Discarded(Reason::HopLimit),
    Event::Discarded(Reason::Unexpected),
    Event::Discarded(Reason::StaleIncarnation),
    Event::Discarded(Reason::Superseded),
    Event::Discarded(Reason::Incomplete),
    Event::Discarded(Reason::StaleEpoch),
];

/// How often each of [`KINDS`] was observed.
pub type Fired = [u64; KINDS.len()];

/// The index of a kind in [`KINDS`].
#[must_use]
pub fn place(event: Event) -> usize {
    KINDS.iter().position(|kind| *kind == event).unwrap_or(0)
}

/// Which kinds of messages a task's ports allow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Abilities {
    receives: bool,
    answers: bool,
    sends: bool,
    asks: bool,
    meets: bool,
}

impl Abilities {
    /// The abilities that a task has by its ports.
    #[must_use]
    pub fn of(task: &TaskView) -> Self {
        let mut all = Self { meets: !task.meetings.is_empty(), ..Self::default() };
        for port in task.ports.iter().filter(|port| port.usage != Usage::Waitfor) {
            let command = port.class == Class::Command;
            if port.capacity > 0 {
                all.receives = true;
                all.answers |= command;
            } else {
                all.sends = true;
                all.asks |= command;
            }
        }
        all
    }

    /// Whether a task with these abilities can reach a transition of this kind. Leases and handlers are not visible in
    /// a task's ports, so their transitions count as possible for every task.
    #[must_use]
    pub const fn allow(self, event: Event) -> bool {
        match event {
            Event::Sent => self.sends,
            Event::Resent
            | Event::Answered
            | Event::RefusedByPeer
            | Event::TimedOut
            | Event::TimedOutUnsent
            | Event::PeerRestarted => self.asks,
            Event::Enqueued | Event::Delivered | Event::Rejected => self.receives,
            Event::Replied => self.answers,
            Event::Reached
            | Event::Rejoined
            | Event::PartnerArrived
            | Event::PartnerAborted
            | Event::Confirmed
            | Event::ReleasedComplete
            | Event::ReleasedByConfirm
            | Event::WithinMargin
            | Event::GaveUp
            | Event::Discarded(Reason::OldRound) => self.meets,
            Event::Discarded(_) => self.receives || self.sends || self.meets,
            Event::Interrupted | Event::Resumed | Event::Granted | Event::TookOver | Event::Fenced => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_a_place_of_its_own_and_every_reason_is_there() {
        for (at, kind) in KINDS.into_iter().enumerate() {
            assert_eq!(place(kind), at);
        }
        for reason in Reason::ALL {
            assert!(KINDS.contains(&Event::Discarded(reason)));
        }
    }
}
