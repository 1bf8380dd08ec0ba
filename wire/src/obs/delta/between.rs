//! Computes the delta between two snapshots.

use super::age::{
    age_meeting, age_timers, age_transit, aged_entry, aged_facts, aged_link, aged_state, counters, facts,
    own_time,
};
use super::{At, Changed, Delta, PortAnew, PortChange, TaskAnew, TaskChange, TaskParts, Waiting};
use crate::obs::snapshot::{Count, LinkView, Snapshot, TaskSnapshot};
use imrs_protocol::{MeetingView, PortCounters, PortView, Ticks};

impl Delta {
    /// A delta that contains all of `new`.
    #[must_use]
    pub fn whole(new: &Snapshot) -> Self {
        Self { base_us: None, ..Self::between(&Snapshot::default(), new) }
    }

    /// Whether the delta contains a whole snapshot, and needs no previous one.
    #[must_use]
    pub const fn is_whole(&self) -> bool {
        self.base_us.is_none()
    }

    /// The delta that changes `old` into `new`.
    #[must_use]
    pub fn between(old: &Snapshot, new: &Snapshot) -> Self {
        let passed = new.mono_us.wrapping_sub(old.mono_us);
        let facts = facts(new);
        let transit_passed = own_time(passed, old.transit_age_us, new.transit_age_us);
        let mut transit = old.transit.clone();
        age_transit(&mut transit, transit_passed);
        let mut timers = old.timers.clone();
        age_timers(&mut timers, passed);
        Self {
            base_us: Some(old.mono_us),
            passed_us: passed,
            node: (aged_facts(old, passed) != facts).then_some(facts),
            tasks: tasks(old, new, passed),
            transit_passed_us: transit_passed,
            transit: (transit != new.transit).then(|| new.transit.clone()),
            timers: (timers != new.timers).then(|| new.timers.clone()),
            links: links(&old.links, &new.links, passed),
            discards: counts(&old.discards, &new.discards),
            link_discards: counts(&old.link_discards, &new.link_discards),
        }
    }
}

fn tasks(old: &Snapshot, new: &Snapshot, passed: u64) -> Changed<TaskChange, TaskAnew> {
    if old.tasks.len() != new.tasks.len() {
        return Changed::Whole(new.tasks.iter().map(TaskAnew::of).collect());
    }
    Changed::Parts(parts(&old.tasks, &new.tasks, |old, new| task(old, new, passed)))
}

/// The changed elements of a list.
fn parts<T, P>(old: &[T], new: &[T], change: impl Fn(&T, &T) -> Option<P>) -> Vec<At<P>> {
    let (mut parts, mut skip) = (Vec::new(), 0);
    for (old, new) in old.iter().zip(new) {
        match change(old, new) {
            Some(what) => {
                parts.push(At { skip, what });
                skip = 0;
            }
            None => skip += 1,
        }
    }
    parts
}

fn task(old: &TaskSnapshot, new: &TaskSnapshot, passed: u64) -> Option<TaskChange> {
    let own = own_time(passed, old.age_us, new.age_us);
    let (before, after) = (&old.view, &new.view);
    let same_parts = before.task == after.task
        && before.ports.len() == after.ports.len()
        && before.ports.iter().zip(&after.ports).all(|(old, new)| fixed(old) == fixed(new))
        && before.meetings.len() == after.meetings.len();
    if !same_parts {
        return Some(TaskChange::Anew(TaskAnew::of(new)));
    }
    let parts = TaskParts {
        passed_us: own,
        liveness: (old.liveness != new.liveness).then_some(new.liveness),
        state: (aged_state(before.state, own) != after.state).then_some(after.state),
        ports: parts(&before.ports, &after.ports, |old, new| port(old, new, own)),
        meetings: parts(&before.meetings, &after.meetings, |old, new| meeting(old, new, own)),
    };
    let nothing = own == 0
        && parts.liveness.is_none()
        && parts.state.is_none()
        && parts.ports.is_empty()
        && parts.meetings.is_empty();
    (!nothing).then_some(TaskChange::Parts(parts))
}

/// The features of a port that never change during one incarnation of its node.
const fn fixed(port: &PortView) -> (u16, u8, bool, u16) {
    (port.port.0, port.usage as u8, matches!(port.class, imrs_protocol::Class::Status), port.capacity)
}

fn port(old: &PortView, new: &PortView, own: u64) -> Option<PortChange> {
    let (mut grown, mut by) = (0, Vec::new());
    if old.counters != new.counters {
        for (bit, (old, new)) in counters(&old.counters).into_iter().zip(counters(&new.counters)).enumerate()
        {
            if old != new {
                grown |= 1 << bit;
                by.push(new.wrapping_sub(old));
            }
        }
    }
    let entries = || old.queue.iter().map(|entry| aged_entry(*entry, own));
    let same = old.len == new.len
        && old.min_slack.map(|left| left - Ticks(own)) == new.min_slack
        && old.queue.len() == new.queue.len()
        && entries().eq(new.queue.iter().copied());
    let waiting =
        (!same).then(|| Waiting { len: new.len, min_slack: new.min_slack, queue: new.queue.clone() });
    (grown != 0 || waiting.is_some()).then_some(PortChange { grown, by, waiting })
}

fn meeting(old: &MeetingView, new: &MeetingView, own: u64) -> Option<MeetingView> {
    let mut old = old.clone();
    age_meeting(&mut old, own);
    (old != *new).then(|| new.clone())
}

fn links(old: &[LinkView], new: &[LinkView], passed: u64) -> Changed<LinkView, LinkView> {
    if old.len() != new.len() {
        return Changed::Whole(new.to_vec());
    }
    Changed::Parts(parts(old, new, |old, new| (aged_link(*old, passed) != *new).then_some(*new)))
}

fn counts(old: &[Count], new: &[Count]) -> Changed<u64, Count> {
    let same = old.len() == new.len() && old.iter().zip(new).all(|(old, new)| old.name == new.name);
    if !same {
        return Changed::Whole(new.to_vec());
    }
    let grown = |old: &Count, new: &Count| new.count.wrapping_sub(old.count);
    Changed::Parts(parts(old, new, |old, new| Some(grown(old, new)).filter(|by| *by != 0)))
}

/// The same port as if it had never been used.
fn untouched(port: &PortView) -> PortView {
    PortView { len: 0, min_slack: None, queue: Vec::new(), counters: PortCounters::default(), ..*port }
}

impl TaskAnew {
    fn of(task: &TaskSnapshot) -> Self {
        let mut before = 0;
        let ports = task.view.ports.iter().map(|port| {
            let further = port.port.0.wrapping_sub(before);
            before = port.port.0;
            PortAnew::of(further, port)
        });
        Self {
            task: task.view.task,
            liveness: task.liveness,
            age_us: task.age_us,
            state: task.view.state,
            ports: ports.collect(),
            meetings: task.view.meetings.clone(),
        }
    }
}

impl PortAnew {
    fn of(further: u16, port: &PortView) -> Self {
        let nothing = PortChange { grown: 0, by: Vec::new(), waiting: None };
        let change = self::port(&untouched(port), port, 0).unwrap_or(nothing);
        Self { further, usage: port.usage, class: port.class, capacity: port.capacity, change }
    }
}
