//! The timeline: the events of all tasks in a causal order. A send comes before its effects, whatever the clocks of the
//! nodes say.
//!
//! The paper has no synchronized clock, and neither has the monitor. The offset of a node's clock comes from a ping or,
//! without one, from the snapshot with the shortest delay. So the order of events on different nodes is an estimate.

use super::trail::Seen;
use super::{IncarnationId, NodeIncarnation, Store};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{Event, PortId, TaskId};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashMap, HashSet};
use std::time::Duration;

/// The least error between the clocks of two nodes that is assumed when the cause of an event is searched. If the
/// comparisons of the clocks have a larger error, that error is assumed.
const APART: Duration = Duration::from_millis(100);

/// An event of a task, as the timeline draws it.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    /// The incarnation of the task's node.
    pub incarnation: IncarnationId,
    /// The task; for a drop in a transit buffer, the task that had sent the packet.
    pub task: TaskId,
    /// Whether the transit buffer of this node dropped the packet.
    pub in_transit: bool,
    /// The event, with its time on the node's own clock.
    pub seen: Seen,
    /// The estimated moment of the event on the monitor's clock.
    pub at: Moment,
    /// The moment by which marks are sorted: [`Mark::at`], but never before the mark's cause.
    pub order: Moment,
    /// The index of the mark in another task that caused this one.
    pub cause: Option<usize>,
}

impl Mark {
    /// A mark without a cause.
    fn of((at, incarnation, seen): (Moment, IncarnationId, &Seen)) -> Self {
        let (task, in_transit) = seen.task.map_or((seen.what.peer, true), |task| (task, false));
        Self { incarnation, task, in_transit, seen: *seen, at, order: at, cause: None }
    }
}

/// A gap: lost events.
#[derive(Clone, Copy, Debug)]
pub struct Gap {
    /// The incarnation whose events were lost.
    pub incarnation: IncarnationId,
    /// How many events were lost.
    pub lost: u64,
    /// The moment before which the events were lost.
    pub order: Moment,
}

/// The marks of a cell in order, and the gaps between them.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// The marks, in order.
    pub marks: Vec<Mark>,
    /// The gaps, in order.
    pub gaps: Vec<Gap>,
}

/// The newest events that the timeline draws of a cell, at most `most`.
#[must_use]
pub fn timeline(store: &Store, cell: &Name, most: usize) -> Timeline {
    timeline_of(store, cell, most, |_| true)
}

/// As [`timeline`], but only of the events that `wanted` selects.
#[must_use]
pub fn timeline_of(store: &Store, cell: &Name, most: usize, wanted: impl Fn(&Seen) -> bool) -> Timeline {
    let incarnations: BTreeSet<IncarnationId> =
        store.incarnations_of(cell).map(|incarnation| incarnation.id).collect();
    let offsets = offsets(store, cell);
    // The sort is of these tuples, because they are smaller than marks.
    let mut found: Vec<(Moment, IncarnationId, &Seen)> = Vec::new();
    let mut gaps = Vec::new();
    for batch in store.trail().batches().rev().filter(|batch| incarnations.contains(&batch.incarnation)) {
        if found.len() >= most {
            break;
        }
        let offset = offsets.get(&batch.incarnation);
        let moment = |seen: &Seen| match offset {
            Some(offset) => moment(seen.mono_us, *offset),
            None => batch.moment(seen),
        };
        if batch.lost > 0 {
            let order = batch.seen.iter().map(moment).min().unwrap_or(batch.at);
            gaps.push(Gap { incarnation: batch.incarnation, lost: batch.lost, order });
        }
        let seen = batch.seen.iter().rev().filter(|seen| wanted(seen));
        found.extend(seen.map(|seen| (moment(seen), batch.incarnation, seen)));
    }
    found.reverse();
    found.sort_by_key(|(at, ..)| *at);
    let mut marks: Vec<Mark> = found.into_iter().map(Mark::of).collect();
    find_causes(&mut marks, apart(store, cell));
    gaps.sort_by_key(|gap| gap.order);
    Timeline { marks: ordered(marks), gaps }
}

/// By how much an effect may seem to be earlier than its cause on another node: the errors of two clocks.
fn apart(store: &Store, cell: &Name) -> Duration {
    let errors = store.incarnations_of(cell).filter_map(|incarnation| Some(incarnation.clock?.error_us));
    errors.max().map_or(APART, |error| APART.max(Duration::from_micros(error.saturating_mul(2))))
}

/// For each incarnation, by how much the monitor's clock is ahead of the node's, in microseconds.
fn offsets(store: &Store, cell: &Name) -> BTreeMap<IncarnationId, i128> {
    store
        .incarnations_of(cell)
        .filter_map(|incarnation| Some((incarnation.id, clock_ahead(incarnation)?)))
        .collect()
}

/// By how much the monitor's clock is ahead of a node's, in microseconds. The value comes from a ping or, without one,
/// from the snapshot with the shortest delay.
#[must_use]
pub fn clock_ahead(incarnation: &NodeIncarnation) -> Option<i128> {
    if let Some(clock) = incarnation.clock {
        return Some(-i128::from(clock.us));
    }
    let samples = [&incarnation.last, &incarnation.base].into_iter().flatten();
    samples.map(|s| micros(s.at) - i128::from(s.snapshot.mono_us)).min()
}

/// The time since a node's start at a moment of the monitor's clock, in microseconds.
#[must_use]
pub fn own_clock(incarnation: &NodeIncarnation, at: Moment) -> Option<u64> {
    u64::try_from(since_start(incarnation, at)?).ok()
}

/// As [`own_clock`], but negative before the node's start.
#[must_use]
pub fn since_start(incarnation: &NodeIncarnation, at: Moment) -> Option<i64> {
    let snapshot = &incarnation.last.as_ref()?.snapshot;
    let mono = micros(at) - clock_ahead(incarnation)?;
    let started = i128::from(snapshot.mono_us) - i128::from(snapshot.uptime_us);
    i64::try_from(mono - started).ok()
}

fn moment(mono_us: u64, offset: i128) -> Moment {
    Duration::from_micros(u64::try_from(i128::from(mono_us) + offset).unwrap_or(0))
}

fn micros(at: Moment) -> i128 {
    i128::try_from(at.as_micros()).unwrap_or(i128::MAX)
}

/// The key under which a cause is found: its task, port, kind and number.
type Act = (TaskId, PortId, Kind, u32);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Kind {
    Message,
    Answer,
    Arrival,
    Confirm,
    GivingUp,
}

/// A port, a kind and a number in one word, which is quicker to hash.
const fn packed(port: PortId, kind: Kind, number: u32) -> u64 {
    (port.0 as u64) << 40 | (kind as u64) << 32 | number as u64
}

/// The key under which later events find this event as their cause; `None` if it causes no other event.
fn act(mark: &Mark) -> Option<Act> {
    let what = mark.seen.what;
    let kind = match what.event {
        Event::Sent => Kind::Message,
        Event::Replied => Kind::Answer,
        Event::Reached | Event::Rejoined => Kind::Arrival,
        Event::Confirmed => Kind::Confirm,
        Event::GaveUp => Kind::GivingUp,
        Event::Resent
        | Event::Enqueued
        | Event::Delivered
        | Event::Answered
        | Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted
        | Event::Discarded(_)
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::ReleasedComplete
        | Event::ReleasedByConfirm
        | Event::WithinMargin
        | Event::Rejected
        | Event::Interrupted
        | Event::Resumed
        | Event::Granted
        | Event::TookOver
        | Event::Fenced => return None,
    };
    Some((mark.task, what.port, kind, what.number))
}

/// The key of a mark's cause. A confirmation does not name the task that sent it, so any task that confirmed the round
/// matches.
fn caused_by(mark: &Mark) -> Option<(Option<TaskId>, PortId, Kind, u32)> {
    let what = mark.seen.what;
    let (from, kind) = match what.event {
        Event::Enqueued | Event::Delivered | Event::Rejected | Event::Discarded(_) => {
            (Some(what.peer), Kind::Message)
        }
        Event::Answered => (Some(what.peer), Kind::Answer),
        Event::PartnerArrived => (Some(what.peer), Kind::Arrival),
        Event::PartnerAborted => (Some(what.peer), Kind::GivingUp),
        Event::ReleasedByConfirm => (None, Kind::Confirm),
        Event::Sent
        | Event::Resent
        | Event::Replied
        | Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted
        | Event::Reached
        | Event::Rejoined
        | Event::Confirmed
        | Event::ReleasedComplete
        | Event::WithinMargin
        | Event::GaveUp
        | Event::Interrupted
        | Event::Resumed
        | Event::Granted
        | Event::TookOver
        | Event::Fenced => return None,
    };
    Some((from, what.port, kind, what.number))
}

/// Finds each mark's cause: the latest match that is not later, otherwise the earliest that is not clearly later.
/// Several marks may match, because numbers restart with each incarnation, and confirmations are repeated. A later
/// repetition must not be the cause, because it would delay all marks after it.
fn find_causes(marks: &mut [Mark], apart: Duration) {
    // `acts` has the last mark per key, and `alike` links each mark to the previous one with the same key.
    let mut acts: HashMap<u64, usize> = HashMap::with_capacity(marks.len());
    let mut alike = vec![None; marks.len()];
    for (at, mark) in marks.iter().enumerate() {
        if let Some((_, port, kind, number)) = act(mark) {
            alike[at] = acts.insert(packed(port, kind, number), at);
        }
    }
    // Only the first event for a message in a task is caused remotely; later ones follow from it.
    let mut had = HashSet::with_capacity(marks.len());
    for at in 0..marks.len() {
        let mark = marks[at];
        let Some((from, port, kind, number)) = caused_by(&mark) else { continue };
        let key = packed(port, kind, number);
        if !had.insert((key, mark.incarnation, mark.task, from)) {
            continue;
        }
        let fits = |&candidate: &usize| {
            let cause: &Mark = &marks[candidate];
            let whose = from.is_none_or(|from| from == cause.task) && cause.task != mark.task;
            whose && cause.at <= mark.at.saturating_add(apart)
        };
        let latest = acts.get(&key).copied();
        let mut found = None;
        for candidate in std::iter::successors(latest, |&at| alike[at]).filter(fits) {
            found = Some(candidate);
            if marks[candidate].at <= mark.at {
                break;
            }
        }
        marks[at].cause = found;
    }
}

/// Sorts the marks, which are in the order of their moments, topologically. Each mark comes after its cause and after
/// earlier marks of its task; otherwise the moment decides.
fn ordered(marks: Vec<Mark>) -> Vec<Mark> {
    // If every cause is earlier by its moment, too, the marks are in order already.
    let is_later = |(at, mark): (usize, &Mark)| mark.cause.is_some_and(|cause| cause >= at);
    if marks.iter().enumerate().any(is_later) { reordered(marks) } else { marks }
}

/// Sorts marks topologically, whatever their causes are.
fn reordered(mut marks: Vec<Mark>) -> Vec<Mark> {
    // For each mark: the next one of its task, its latest effect, and the previous effect of the same cause.
    let mut next_own = vec![None; marks.len()];
    let mut effect = vec![None; marks.len()];
    let mut other_effect = vec![None; marks.len()];
    let mut open: Vec<usize> = vec![0; marks.len()];
    let mut last: HashMap<(IncarnationId, TaskId, bool), usize> = HashMap::new();
    for at in 0..marks.len() {
        let mark = marks[at];
        if let Some(before) = last.insert((mark.incarnation, mark.task, mark.in_transit), at) {
            next_own[before] = Some(at);
            open[at] += 1;
        }
        if let Some(cause) = mark.cause {
            other_effect[at] = effect[cause].replace(at);
            open[at] += 1;
        }
    }
    let ready = (0..marks.len()).filter(|&at| open[at] == 0);
    let mut ready: BinaryHeap<_> = ready.map(|at| Reverse((marks[at].order, at))).collect();
    let mut order = Vec::with_capacity(marks.len());
    let mut placed = vec![usize::MAX; marks.len()];
    let (mut latest, mut first_open) = (Duration::ZERO, 0);
    while order.len() < marks.len() {
        let Some(Reverse((moment, at))) = ready.pop() else {
            // Node data is untrusted, so causes may form a cycle. Then the cause of the first unplaced mark is dropped.
            // The earlier marks of its task are placed, so only the cause blocks it.
            while placed.get(first_open).is_some_and(|place| *place != usize::MAX) {
                first_open += 1;
            }
            let Some(mark) = marks.get_mut(first_open) else { break };
            mark.cause = None;
            mark.order = mark.order.max(latest);
            ready.push(Reverse((mark.order, first_open)));
            continue;
        };
        latest = moment;
        placed[at] = order.len();
        order.push(at);
        let after = std::iter::successors(effect[at], |&effect| other_effect[effect]).chain(next_own[at]);
        for next in after.filter(|&next| placed[next] == usize::MAX) {
            marks[next].order = marks[next].order.max(moment);
            open[next] = open[next].saturating_sub(1);
            if open[next] == 0 {
                ready.push(Reverse((marks[next].order, next)));
            }
        }
    }
    let placed_cause = |mark: &Mark| mark.cause.and_then(|cause| placed.get(cause).copied());
    order.iter().map(|&at| Mark { cause: placed_cause(&marks[at]), ..marks[at] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Observation, Ticks};
    use proptest::prelude::*;

    fn mark((ms, task, cause): (u64, u16, Option<usize>)) -> Mark {
        let what = Observation {
            event: Event::Delivered,
            port: PortId(0),
            peer: TaskId(0),
            number: 0,
            remaining: Ticks(0),
        };
        let seen = Seen { mono_us: ms * 1_000, task: Some(TaskId(task)), what };
        Mark { cause, ..Mark::of((Duration::from_millis(ms), IncarnationId(u32::from(task / 2)), &seen)) }
    }

    proptest! {
        /// `ordered` returns marks that need no sorting as they are. For any marks it must return what `reordered`
        /// returns.
        #[test]
        fn marks_in_order_are_sorted_as_all_others_are(
            drawn in prop::collection::vec((0_u64..40, 0_u16..6, prop::option::of(0_usize..60), any::<bool>()), 0..60),
        ) {
            let mut drawn = drawn;
            drawn.sort_by_key(|(ms, ..)| *ms);
            let all = drawn.len();
            // Most causes are earlier marks, and some are later ones. A mark is never its own cause.
            let cause = |at: usize, (_, _, cause, is_earlier): (u64, u16, Option<usize>, bool)| {
                let cause = cause?;
                if is_earlier { cause.checked_rem(at) } else { Some(cause % all).filter(|cause| *cause != at) }
            };
            for marks in [true, false].map(|only_earlier| {
                let of = |(at, one): (usize, &(u64, u16, Option<usize>, bool))| {
                    mark((one.0, one.1, cause(at, (one.0, one.1, one.2, one.3 || only_earlier))))
                };
                drawn.iter().enumerate().map(of).collect::<Vec<Mark>>()
            }) {
                let show = |marks: Vec<Mark>| {
                    let of = |mark: &Mark| (mark.seen.mono_us, mark.task, mark.at, mark.order, mark.cause);
                    marks.iter().map(of).collect::<Vec<_>>()
                };
                prop_assert_eq!(show(ordered(marks.clone())), show(reordered(marks)));
            }
        }
    }
}
