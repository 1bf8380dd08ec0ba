//! The history of one message: its stages, its remaining time at each stage, and the time that each stage took.

use super::timeline::{Mark, own_clock, timeline_of};
use super::trail::{KEPT, Seen};
use super::{IncarnationId, Store};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{Event, Incarnation, PortId, TaskId};

/// Identifies a message: its source, its port, the source's number for it, and the incarnation of the source's node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageKey {
    /// The task that sent the message.
    pub source: TaskId,
    /// The port of the message.
    pub port: PortId,
    /// The sequence number of the message.
    pub number: u32,
    /// The incarnation of the source's node that sent the message, because each incarnation begins its numbers anew.
    /// `None` if it is unknown; then the key is that of the latest message with these numbers.
    pub incarnation: Option<Incarnation>,
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
pub fn stages_of(store: &Store, cell: &Name, key: MessageKey) -> Vec<Stage> {
    let marks = alike(store, cell, key);
    let latest = marks.last().and_then(|(_, sender)| *sender);
    let wanted = key.incarnation.or(latest);
    let marks = marks.into_iter().filter(|(_, sender)| sender.is_none() || *sender == wanted);
    let tick_us = |incarnation: IncarnationId| {
        store.incarnation(incarnation).map_or(1, |incarnation| incarnation.tick_us)
    };
    let mut stages: Vec<Stage> = Vec::new();
    for (mark, _) in marks {
        let left_us = mark.seen.what.remaining.0.saturating_mul(tick_us(mark.incarnation));
        let after = before(&stages, &mark, key);
        let from = after.and_then(|at| stages.get(at));
        let charged_us = from.and_then(|from| from.left_us.checked_sub(left_us));
        let passed = from.and_then(|from| passed(&from.mark, &mark));
        stages.push(Stage { mark, left_us, after, charged_us, passed });
    }
    stages
}

/// The marks of all messages that differ from this one at most by the incarnation of their source's node, causes first.
/// With each of them, the incarnation that sent the message, if it is known.
fn alike(store: &Store, cell: &Name, key: MessageKey) -> Vec<(Mark, Option<Incarnation>)> {
    let is_alike =
        |seen: &Seen| key_of(seen).is_some_and(|of| MessageKey { incarnation: key.incarnation, ..of } == key);
    let marks = timeline_of(store, cell, KEPT, is_alike).marks;
    let is_own = |mark: &Mark| mark.task == key.source && !mark.in_transit;
    // A mark at another task belongs to the last send before it. A mark before the first send belongs to the incarnation
    // before, if the monitor knows one.
    let first = marks.iter().find(|mark| is_own(mark)).and_then(|mark| {
        let first = store.incarnation(mark.incarnation)?;
        let others = store.incarnations_of(cell).filter(|other| other.node_id == first.node_id);
        let earlier = others.take_while(|other| other.number != first.number).last();
        Some(Incarnation(earlier.unwrap_or(first).number))
    });
    let sender = |sender: &mut Option<Incarnation>, mark: Mark| {
        if is_own(&mark) {
            *sender = store.incarnation(mark.incarnation).map(|one| Incarnation(one.number));
        }
        Some((mark, *sender))
    };
    marks.into_iter().scan(first, sender).collect()
}

/// The message that an observation at the moment `at` is about, if it is about one.
#[must_use]
pub fn message_at(store: &Store, cell: &Name, seen: &Seen, at: Moment) -> Option<MessageKey> {
    let key = key_of(seen)?;
    let marks = alike(store, cell, key);
    let same = marks.iter().filter(|(mark, _)| (mark.seen.task, mark.seen.what) == (seen.task, seen.what));
    let nearest = same.min_by_key(|(mark, _)| mark.at.abs_diff(at));
    // Without a mark, the sender is the incarnation that ran at that moment.
    let home = store.names(cell).and_then(|names| names.home(key.source));
    let ran = || {
        let all = store.incarnations_of(cell).filter(|one| Some(one.node_id) == home);
        all.filter(|one| own_clock(one, at).is_some()).last().map(|one| Incarnation(one.number))
    };
    Some(MessageKey { incarnation: nearest.map_or_else(ran, |(_, sender)| *sender), ..key })
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

/// The message that an observation is about, if it is about one, without the incarnation of its source's node.
fn key_of(seen: &Seen) -> Option<MessageKey> {
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
    Some(MessageKey { source, port: what.port, number: what.number, incarnation: None })
}
