//! What changed from one snapshot to the next: nothing is said of what only grew older.
//!
//! A remaining time is compared as the instant that it ends at. Where the snapshot before, made older by the time that
//! passed, is the new one, nothing is sent: a node in which nothing happens costs a few bytes a period. The law is
//! `old.apply(&Delta::between(&old, &new))` gives `new`, whatever the two are. A whole snapshot is told as what changed
//! since there was nothing.

use super::frames::{Count, LinkView, Liveness, RealTime, Snapshot, TaskSnapshot, TimerEntry};
use imrs_protocol::{
    Class, MeetingView, PortCounters, PortId, PortView, QueueEntry, TaskId, TaskState, TaskView, Ticks,
    TransitView, Usage,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How many counters a port has.
const COUNTERS: usize = 11;

/// A part of a list that changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct At<T> {
    /// How many that did not change lie between the one before and this one.
    pub skip: u32,
    /// What changed.
    pub what: T,
}

/// What became of a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Changed<P, W> {
    /// Its elements are those of before, and of these something changed.
    Parts(Vec<At<P>>),
    /// It is now this.
    Whole(Vec<W>),
}

/// What changed between two snapshots of one node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delta {
    /// [`Snapshot::mono_us`] of the snapshot that it changes. `None`: it is whole, and takes the place of any.
    pub base_us: Option<u64>,
    /// How much later the new one was taken, in microseconds; where it is whole, since the clock's start.
    pub passed_us: u64,
    /// What a node has besides its parts, where it changed.
    pub node: Option<NodeFacts>,
    /// Its tasks.
    pub tasks: Changed<TaskChange, TaskAnew>,
    /// By how many microseconds the transit buffer's own time went on.
    pub transit_passed_us: u64,
    /// The transit buffer, where more than its time changed.
    pub transit: Option<TransitView>,
    /// The Timer's entries, where more than their time changed.
    pub timers: Option<Vec<TimerEntry>>,
    /// Its links.
    pub links: Changed<LinkView, LinkView>,
    /// By how much the counters of messages dropped by its machines grew.
    pub discards: Changed<u64, Count>,
    /// By how much those of its links grew.
    pub link_discards: Changed<u64, Count>,
}

/// What a node has besides its parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeFacts {
    /// [`Snapshot::uptime_us`].
    pub uptime_us: u64,
    /// [`Snapshot::insecure`].
    pub insecure: bool,
    /// [`Snapshot::real_time`].
    pub real_time: RealTime,
}

/// What became of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TaskChange {
    /// These parts of it changed.
    Parts(TaskParts),
    /// It has other ports or meetings than before.
    Anew(TaskAnew),
}

/// What changed of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskParts {
    /// By how many microseconds the communication task's own time went on.
    pub passed_us: u64,
    /// Whether it still runs, if that changed.
    pub liveness: Option<Liveness>,
    /// What it does, if more than its time changed.
    pub state: Option<TaskState>,
    /// Its ports.
    pub ports: Vec<At<PortChange>>,
    /// Its waitfors.
    pub meetings: Vec<At<MeetingView>>,
}

/// What changed of a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortChange {
    /// Which of its counters grew: the bits in the order of [`PortCounters`], from the lowest.
    pub grown: u16,
    /// By how much each of them did.
    pub by: Vec<u64>,
    /// What waits there, if more than its time changed.
    pub waiting: Option<Waiting>,
}

/// A task, whatever was known of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskAnew {
    /// [`TaskView::task`].
    pub task: TaskId,
    /// [`TaskSnapshot::liveness`].
    pub liveness: Liveness,
    /// [`TaskSnapshot::age_us`].
    pub age_us: u64,
    /// [`TaskView::state`].
    pub state: TaskState,
    /// [`TaskView::ports`].
    pub ports: Vec<PortAnew>,
    /// [`TaskView::meetings`].
    pub meetings: Vec<MeetingView>,
}

/// A port, whatever was known of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortAnew {
    /// By how much its number is greater than that of the port before, or than 0, counted around the end of the numbers.
    pub further: u16,
    /// [`PortView::usage`].
    pub usage: Usage,
    /// [`PortView::class`].
    pub class: Class,
    /// [`PortView::capacity`].
    pub capacity: u16,
    /// How it differs from a port at which nothing ever happened.
    pub change: PortChange,
}

/// What waits at a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Waiting {
    /// [`PortView::len`].
    pub len: u16,
    /// [`PortView::min_slack`].
    pub min_slack: Option<Ticks>,
    /// [`PortView::queue`].
    pub queue: Vec<QueueEntry>,
}

/// Why a delta cannot be applied. The snapshot is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum DeltaError {
    /// It changes another snapshot.
    #[error("a change of the snapshot at {wanted} us, the last one is of {have} us")]
    OtherBase {
        /// The snapshot that it changes.
        wanted: u64,
        /// The snapshot that there is.
        have: u64,
    },
    /// It changes something that the snapshot does not have.
    #[error("a change of something that the snapshot does not have")]
    NoSuchPart,
    /// It names other counters than it has growths for.
    #[error("a change of counters that is not one for each")]
    OtherCounters,
}

impl Delta {
    /// All of `new`.
    #[must_use]
    pub fn whole(new: &Snapshot) -> Self {
        Self { base_us: None, ..Self::between(&Snapshot::default(), new) }
    }

    /// Whether it is all of a snapshot, and needs no other.
    #[must_use]
    pub const fn is_whole(&self) -> bool {
        self.base_us.is_none()
    }

    /// What `old` lacks of `new`.
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

impl Snapshot {
    /// Makes of this snapshot the one that `delta` leads to.
    ///
    /// # Errors
    /// [`DeltaError`]; then nothing of it was changed.
    pub fn apply(&mut self, delta: &Delta) -> Result<(), DeltaError> {
        match delta.base_us {
            Some(wanted) if wanted != self.mono_us => {
                return Err(DeltaError::OtherBase { wanted, have: self.mono_us });
            }
            Some(_) => fits(self, delta)?,
            None => {
                fits(&Self::default(), delta)?;
                *self = Self::default();
            }
        }
        let passed = delta.passed_us;
        let facts = delta.node.unwrap_or_else(|| aged_facts(self, passed));
        self.mono_us = self.mono_us.wrapping_add(passed);
        (self.uptime_us, self.insecure, self.real_time) = (facts.uptime_us, facts.insecure, facts.real_time);
        match &delta.tasks {
            Changed::Whole(tasks) => self.tasks = tasks.iter().map(TaskAnew::task).collect(),
            Changed::Parts(parts) => {
                self.tasks.iter_mut().for_each(|task| task.age_us = task.age_us.wrapping_add(passed));
                each(&mut self.tasks, parts, change_task);
            }
        }
        self.transit_age_us = aged(self.transit_age_us, passed, delta.transit_passed_us);
        match &delta.transit {
            Some(transit) => self.transit.clone_from(transit),
            None => age_transit(&mut self.transit, delta.transit_passed_us),
        }
        match &delta.timers {
            Some(timers) => self.timers.clone_from(timers),
            None => age_timers(&mut self.timers, passed),
        }
        match &delta.links {
            Changed::Whole(links) => self.links.clone_from(links),
            Changed::Parts(parts) => {
                self.links.iter_mut().for_each(|link| *link = aged_link(*link, passed));
                each(&mut self.links, parts, |link, new| *link = *new);
            }
        }
        grow(&mut self.discards, &delta.discards);
        grow(&mut self.link_discards, &delta.link_discards);
        Ok(())
    }
}

/// By how much the own time of something went on, of which the snapshots were so old.
const fn own_time(passed: u64, old_age: u64, new_age: u64) -> u64 {
    passed.wrapping_sub(new_age).wrapping_add(old_age)
}

const fn aged(age: u64, passed: u64, own: u64) -> u64 {
    age.wrapping_add(passed).wrapping_sub(own)
}

const fn facts(of: &Snapshot) -> NodeFacts {
    NodeFacts { uptime_us: of.uptime_us, insecure: of.insecure, real_time: of.real_time }
}

const fn aged_facts(of: &Snapshot, passed: u64) -> NodeFacts {
    NodeFacts { uptime_us: of.uptime_us.wrapping_add(passed), ..facts(of) }
}

fn tasks(old: &Snapshot, new: &Snapshot, passed: u64) -> Changed<TaskChange, TaskAnew> {
    if old.tasks.len() != new.tasks.len() {
        return Changed::Whole(new.tasks.iter().map(TaskAnew::of).collect());
    }
    Changed::Parts(parts(&old.tasks, &new.tasks, |old, new| task(old, new, passed)))
}

/// What became of each element of a list, where something did.
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

/// Hands every element that changed to `change`. Its place was looked at by [`fits`].
fn each<T, P>(list: &mut [T], parts: &[At<P>], mut change: impl FnMut(&mut T, &P)) {
    let mut rest = list.iter_mut();
    for part in parts {
        if let Some(element) = rest.nth(part.skip as usize) {
            change(element, &part.what);
        }
    }
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

/// What never changes of a port while its node lives.
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

fn change_task(task: &mut TaskSnapshot, change: &TaskChange) {
    let parts = match change {
        TaskChange::Anew(anew) => {
            *task = anew.task();
            return;
        }
        TaskChange::Parts(parts) => parts,
    };
    let own = parts.passed_us;
    task.age_us = task.age_us.wrapping_sub(own);
    task.liveness = parts.liveness.unwrap_or(task.liveness);
    task.view.state = parts.state.unwrap_or_else(|| aged_state(task.view.state, own));
    age_parts(&mut task.view, own);
    each(&mut task.view.ports, &parts.ports, change_port);
    each(&mut task.view.meetings, &parts.meetings, Clone::clone_from);
}

fn change_port(port: &mut PortView, change: &PortChange) {
    let mut by = change.by.iter();
    let mut all = counters(&port.counters);
    for (bit, counter) in all.iter_mut().enumerate() {
        if change.grown & (1 << bit) != 0 {
            *counter = counter.wrapping_add(by.next().copied().unwrap_or(0));
        }
    }
    port.counters = counters_of(all);
    if let Some(Waiting { len, min_slack, queue }) = &change.waiting {
        (port.len, port.min_slack) = (*len, *min_slack);
        port.queue.clone_from(queue);
    }
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

    fn task(&self) -> TaskSnapshot {
        let mut at = 0_u16;
        let ports = self.ports.iter().map(|port| {
            at = at.wrapping_add(port.further);
            port.port(PortId(at))
        });
        let view = TaskView {
            task: self.task,
            state: self.state,
            ports: ports.collect(),
            meetings: self.meetings.clone(),
        };
        TaskSnapshot { liveness: self.liveness, age_us: self.age_us, view }
    }
}

impl PortAnew {
    fn of(further: u16, port: &PortView) -> Self {
        let nothing = PortChange { grown: 0, by: Vec::new(), waiting: None };
        let change = self::port(&untouched(port), port, 0).unwrap_or(nothing);
        Self { further, usage: port.usage, class: port.class, capacity: port.capacity, change }
    }

    fn port(&self, port: PortId) -> PortView {
        let mut view = PortView {
            port,
            usage: self.usage,
            class: self.class,
            len: 0,
            capacity: self.capacity,
            min_slack: None,
            queue: Vec::new(),
            counters: PortCounters::default(),
        };
        change_port(&mut view, &self.change);
        view
    }
}

/// The port, had nothing ever happened there.
fn untouched(port: &PortView) -> PortView {
    PortView { len: 0, min_slack: None, queue: Vec::new(), counters: PortCounters::default(), ..*port }
}

fn age_parts(view: &mut TaskView, own: u64) {
    if own == 0 {
        return;
    }
    for port in &mut view.ports {
        port.min_slack = port.min_slack.map(|left| left - Ticks(own));
        port.queue.iter_mut().for_each(|entry| *entry = aged_entry(*entry, own));
    }
    view.meetings.iter_mut().for_each(|meeting| age_meeting(meeting, own));
}

fn aged_entry(entry: QueueEntry, own: u64) -> QueueEntry {
    QueueEntry { remaining: entry.remaining - Ticks(own), ..entry }
}

fn aged_state(state: TaskState, own: u64) -> TaskState {
    let own = Ticks(own);
    match state {
        TaskState::Running | TaskState::Delaying => state,
        TaskState::Receiving { port, remaining } => {
            TaskState::Receiving { port, remaining: remaining.map(|left| left - own) }
        }
        TaskState::AwaitingReply { port, from, remaining } => {
            TaskState::AwaitingReply { port, from, remaining: remaining - own }
        }
        TaskState::Waiting { port, round, remaining } => {
            TaskState::Waiting { port, round, remaining: remaining - own }
        }
    }
}

fn age_meeting(meeting: &mut MeetingView, own: u64) {
    let older = |left: Option<Ticks>| left.map(|left| left - Ticks(own));
    meeting.remaining = older(meeting.remaining);
    meeting.members.iter_mut().for_each(|member| member.remaining = older(member.remaining));
}

fn age_transit(transit: &mut TransitView, own: u64) {
    transit.min_slack = transit.min_slack.map(|left| left - Ticks(own));
}

fn age_timers(timers: &mut [TimerEntry], passed: u64) {
    timers.iter_mut().for_each(|timer| timer.remaining = timer.remaining - Ticks(passed));
}

fn aged_link(link: LinkView, passed: u64) -> LinkView {
    LinkView { heard_us: link.heard_us.map(|ago| ago.wrapping_add(passed)), ..link }
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

fn grow(counts: &mut Vec<Count>, change: &Changed<u64, Count>) {
    match change {
        Changed::Whole(new) => counts.clone_from(new),
        Changed::Parts(parts) => {
            each(counts, parts, |count, by| count.count = count.count.wrapping_add(*by));
        }
    }
}

const fn counters(of: &PortCounters) -> [u64; COUNTERS] {
    [
        of.sent,
        of.resent,
        of.enqueued,
        of.delivered,
        of.expired,
        of.refused,
        of.rejected,
        of.evicted,
        of.duplicates,
        of.timed_out,
        of.dropped,
    ]
}

const fn counters_of(all: [u64; COUNTERS]) -> PortCounters {
    let [
        sent,
        resent,
        enqueued,
        delivered,
        expired,
        refused,
        rejected,
        evicted,
        duplicates,
        timed_out,
        dropped,
    ] = all;
    PortCounters {
        sent,
        resent,
        enqueued,
        delivered,
        expired,
        refused,
        rejected,
        evicted,
        duplicates,
        timed_out,
        dropped,
    }
}

/// Whether everything that `delta` changes is there.
fn fits(snapshot: &Snapshot, delta: &Delta) -> Result<(), DeltaError> {
    match &delta.tasks {
        Changed::Whole(tasks) => tasks.iter().try_for_each(fits_anew)?,
        Changed::Parts(parts) => {
            let mut tasks = snapshot.tasks.iter();
            for part in parts {
                let task = tasks.nth(part.skip as usize).ok_or(DeltaError::NoSuchPart)?;
                match &part.what {
                    TaskChange::Parts(parts) => fits_task(task, parts)?,
                    TaskChange::Anew(anew) => fits_anew(anew)?,
                }
            }
        }
    }
    fits_list(&snapshot.links, &delta.links)?;
    fits_list(&snapshot.discards, &delta.discards)?;
    fits_list(&snapshot.link_discards, &delta.link_discards)
}

fn fits_task(task: &TaskSnapshot, parts: &TaskParts) -> Result<(), DeltaError> {
    fits_parts(task.view.ports.len(), &parts.ports)?;
    fits_parts(task.view.meetings.len(), &parts.meetings)?;
    parts.ports.iter().try_for_each(|at| fits_port(&at.what))
}

fn fits_anew(task: &TaskAnew) -> Result<(), DeltaError> {
    task.ports.iter().try_for_each(|port| fits_port(&port.change))
}

fn fits_port(change: &PortChange) -> Result<(), DeltaError> {
    let one_each = change.grown.count_ones() as usize == change.by.len() && change.grown < 1 << COUNTERS;
    if one_each { Ok(()) } else { Err(DeltaError::OtherCounters) }
}

fn fits_list<T, P>(list: &[T], change: &Changed<P, T>) -> Result<(), DeltaError> {
    match change {
        Changed::Parts(parts) => fits_parts(list.len(), parts),
        Changed::Whole(_) => Ok(()),
    }
}

fn fits_parts<P>(length: usize, parts: &[At<P>]) -> Result<(), DeltaError> {
    let last = parts.iter().map(|part| u64::from(part.skip) + 1).sum::<u64>();
    if last <= length as u64 { Ok(()) } else { Err(DeltaError::NoSuchPart) }
}
