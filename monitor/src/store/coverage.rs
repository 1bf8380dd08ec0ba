//! Which transitions of the machine were seen at work, of all that there are (D63).

use imrs_protocol::{Class, Event, Reason, TaskView};

/// All kinds of observations, in the order in which they are told.
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

/// The place of a kind in [`KINDS`].
#[must_use]
pub fn place(event: Event) -> usize {
    KINDS.iter().position(|kind| *kind == event).unwrap_or(0)
}

/// Whether a task with these ports can come to a transition of this kind at all. What belongs to couples and handlers
/// is not seen in a task's ports: it is possible for every task.
#[must_use]
pub fn is_possible(event: Event, task: &TaskView) -> bool {
    let messages = task.ports.iter().any(|p| p.usage != imrs_protocol::Usage::Waitfor);
    let receives = task.ports.iter().any(|p| p.capacity > 0);
    let sends = task.ports.iter().any(|p| p.capacity == 0 && p.usage != imrs_protocol::Usage::Waitfor);
    let commands =
        task.ports.iter().any(|p| p.class == Class::Command && p.usage != imrs_protocol::Usage::Waitfor);
    let meets = !task.meetings.is_empty();
    match event {
        Event::Sent => sends,
        Event::Resent
        | Event::Answered
        | Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted => sends && commands,
        Event::Enqueued | Event::Delivered | Event::Rejected => receives,
        Event::Replied => receives && commands,
        Event::Reached
        | Event::Rejoined
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::Confirmed
        | Event::ReleasedComplete
        | Event::ReleasedByConfirm
        | Event::WithinMargin
        | Event::GaveUp => meets,
        Event::Discarded(Reason::OldRound) => meets,
        Event::Discarded(_) => messages || meets,
        Event::Interrupted | Event::Resumed | Event::Granted | Event::TookOver | Event::Fenced => true,
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
