//! The history of one message: its stages, its remaining time at each stage, and the time that each stage took.

use super::timeline::{Mark, timeline_of};
use super::trail::{KEPT, Seen};
use super::{IncarnationId, Store};
use crate::name::Name;
use imrs_protocol::{Event, PortId, TaskId};

/// Identifies a message: its source, its port, and the source's number for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageKey {
    /// The task that sent the message.
    pub source: TaskId,
    /// The port of the message.
    pub port: PortId,
    /// The sequence number of the message.
    pub number: u32,
}

/// A stage: an event of one message.
#[derive(Clone, Copy, Debug)]
pub struct Stage {
    /// The event, with place and time.
    pub mark: Mark,
    /// The remaining time of the message, in microseconds.
    pub left_us: u64,
    /// The index of the stage from which this stage follows.
    pub after: Option<usize>,
    /// The time that the protocol charged the message since the stage `after`, in microseconds.
    pub charged_us: Option<u64>,
    /// The time that passed since the stage `after`, by the clocks.
    pub passed: Option<Passed>,
}

/// The time that passed between two stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passed {
    /// The time, in microseconds.
    pub us: u64,
    /// Whether the time comes from the clocks of two nodes, and so is an estimate.
    pub estimated: bool,
}

/// The stages of a message, causes first. Empty if nothing is known about the message.
#[must_use]
pub fn incarnation_of(store: &Store, cell: &Name, key: MessageKey) -> Vec<Stage> {
    let marks = timeline_of(store, cell, KEPT, |seen| concerns(seen, key)).marks;
    let tick_us = |incarnation: IncarnationId| {
        store.incarnation(incarnation).map_or(1, |incarnation| incarnation.tick_us)
    };
    let mut stages: Vec<Stage> = Vec::new();
    for mark in marks {
        let left_us = mark.seen.what.remaining.0.saturating_mul(tick_us(mark.incarnation));
        let after = before(&stages, &mark, key);
        let from = after.and_then(|at| stages.get(at));
        let charged_us = from.and_then(|from| from.left_us.checked_sub(left_us));
        let passed = from.and_then(|from| passed(&from.mark, &mark));
        stages.push(Stage { mark, left_us, after, charged_us, passed });
    }
    stages
}

/// The stage from which `mark` follows: the previous one at the same place, or else the send. An answer follows from
/// the reply, or from the send of the request, so that the way of the answer is charged, too.
fn before(stages: &[Stage], mark: &Mark, key: MessageKey) -> Option<usize> {
    let same = |s: &Stage| (s.mark.incarnation, s.mark.task, s.mark.in_transit) == place(mark);
    let event = |wanted: Event| move |s: &Stage| s.mark.seen.what.event == wanted;
    let replied = stages.iter().rposition(event(Event::Replied));
    let sent = stages.iter().rposition(event(Event::Sent));
    match mark.seen.what.event {
        Event::Answered => replied.or(sent),
        _ if mark.task == key.source && !mark.in_transit => stages.iter().rposition(same),
        _ => stages.iter().rposition(same).or(sent),
    }
}

const fn place(mark: &Mark) -> (IncarnationId, TaskId, bool) {
    (mark.incarnation, mark.task, mark.in_transit)
}

fn passed(from: &Mark, to: &Mark) -> Option<Passed> {
    if from.incarnation == to.incarnation {
        let us = to.seen.mono_us.checked_sub(from.seen.mono_us)?;
        return Some(Passed { us, estimated: false });
    }
    let us = to.at.saturating_sub(from.at).as_micros();
    Some(Passed { us: u64::try_from(us).unwrap_or(u64::MAX), estimated: true })
}

/// The message that an observation is about, if it is about one.
#[must_use]
pub fn key_of(seen: &Seen) -> Option<MessageKey> {
    let what = seen.what;
    let source = match what.event {
        Event::Sent
        | Event::Resent
        | Event::Answered
        | Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted => seen.task?,
        Event::Enqueued | Event::Delivered | Event::Replied | Event::Discarded(_) | Event::Rejected => {
            what.peer
        }
        Event::Reached
        | Event::Rejoined
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::Confirmed
        | Event::ReleasedComplete
        | Event::ReleasedByConfirm
        | Event::WithinMargin
        | Event::GaveUp
        | Event::Interrupted
        | Event::Resumed
        | Event::Granted
        | Event::TookOver
        | Event::Fenced => return None,
    };
    Some(MessageKey { source, port: what.port, number: what.number })
}

fn concerns(seen: &Seen, key: MessageKey) -> bool {
    key_of(seen) == Some(key)
}
