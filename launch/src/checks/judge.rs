//! Judges the checks of a cell in a run. It takes the changes of values that the nodes reported, in the order of their
//! times.

mod evaluate;

use super::told::{Outcome, Settled, Settlement, Unvouched};
use super::vouch::{CommandEvent, Doubt, Vouched};
use super::{Ask, Change, asks, of, terms};
use crate::cells::Loaded;
use evaluate::dead;
use imrs_language::lower::CheckKind;
use imrs_protocol::{NodeId, TaskId};
use imrs_runtime::guard::Notice;
use std::collections::{BTreeMap, BTreeSet};

/// The resolution, in microseconds, of the order of two steps on different nodes: each time is rounded up to a whole microsecond.
/// If a state seems to have lasted no longer than this, the two steps may have happened in the other order, without that state.
const READING: u64 = 1;
/// How many events the judge keeps while it waits for a silent node's report. If there are more, the judge drops waiting changes.
const WAITING: usize = if cfg!(test) { 64 } else { 1 << 20 };
/// A killed node may have been silent for this long before the kill, in microseconds: a node reports every 20 ms, or later if the
/// machine is busy.
const LAST_WORDS: u64 = 1_000_000;
/// How many breaks of each check are reported in detail.
const TOLD: usize = 3;

/// Judges the checks of a run.
pub struct Judge<'a> {
    loaded: &'a Loaded,
    /// For each task, which of its values the checks read.
    asks: Vec<Vec<Ask>>,
    /// For each task, its current values in the order of `asks`; `None` if a value is not known.
    stand: Vec<Vec<Option<i64>>>,
    /// For each task, why some of its values are not known; `None` while the task's node reports all of them, and before the
    /// node's first report.
    unknown: Vec<Option<Doubt>>,
    /// The state of each check.
    states: Vec<CheckState>,
    vouched: Vouched,
    /// Pending events by time; events of the same time in the order in which they came.
    changes: BTreeMap<(u64, u64), Event>,
    came: u64,
    /// For each node, the instant up to which it has reported everything; `None` if the node does not report to this judge.
    told: Vec<Option<u64>>,
    /// For each node, when it was killed; `None` again once the pipe of the node has ended.
    killed: Vec<Option<u64>>,
    /// The end of the run: the first instant that is not judged.
    over: u64,
    settled: u64,
    /// For each node, why changes of its tasks are missing.
    missing: Vec<Option<Doubt>>,
}

enum Event {
    Change(Change),
    /// The node has stopped reporting.
    Unknown(NodeId),
    /// The node runs, but could not report all changes since this event.
    Untold(NodeId),
    /// The node is dead.
    Dead(NodeId),
    /// The node was restarted.
    Back(NodeId),
    /// An event of the command with this key.
    Command(String, CommandEvent),
}

/// The state of one check during the judgement.
#[derive(Default)]
struct CheckState {
    /// The first task of the check whose node does not report to this judge.
    elsewhere: Option<TaskId>,
    /// Whether the check could be evaluated at any time so far.
    judged: bool,
    /// For `leads`: how often the premise became true, and whether it is true now.
    mattered: u64,
    matters: bool,
    /// Since when an `always` or `never` is broken, and the values that it had then.
    since: Option<(u64, Vec<String>)>,
    /// Why it is unknown whether the check holds now; `None` if it is known.
    doubt: Option<Doubt>,
    /// For how long it was unknown whether the check held, by reason.
    doubted: BTreeMap<Doubt, u64>,
    /// Whether the current break of the check has been reported.
    is_told: bool,
    /// For `leads`: since when the check waits for its consequence, and when the consequence is late.
    due: Option<(u64, u64)>,
    times: u64,
    broken: Vec<Broken>,
}

impl CheckState {
    /// For how long it is unknown whether the check held, and the main reason. The last messages of a killed node are always
    /// missing, so their absence alone does not count.
    fn unvouched(&self) -> Option<(Doubt, u64)> {
        let counts = |(doubt, length): &(&Doubt, &u64)| match doubt {
            Doubt::Silent(_) => **length > LAST_WORDS,
            Doubt::Command(_) | Doubt::Untold(_) | Doubt::Dropped | Doubt::Dead(_) => **length > 0,
        };
        let (doubt, _) = self.doubted.iter().filter(counts).max_by_key(|(_, length)| **length)?;
        Some((*doubt, self.doubted.values().sum()))
    }
}

/// A break of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Broken {
    /// The index of the check.
    pub check: usize,
    /// When the check was broken, in microseconds of the clock that all nodes share.
    pub at: u64,
    /// For `leads`: since when the check waited for its consequence.
    pub since: Option<u64>,
    /// The values that the check reads: `armL.me.moving = true`.
    pub values: Vec<String>,
}

impl<'a> Judge<'a> {
    /// Starts to judge a run. The nodes in `here` report to this judge, and have reported nothing yet.
    pub fn new(loaded: &'a Loaded, here: &[NodeId]) -> Self {
        let cell = loaded.table.cell();
        let asks = asks(loaded);
        let told = (0..cell.nodes.len()).map(|node| here.contains(&NodeId::from_index(node)).then_some(0));
        let is_elsewhere = |task: &TaskId| {
            loaded.table.location(*task).is_none_or(|node| !here.contains(&node))
                || loaded.program(*task).is_none()
        };
        let state = |check| {
            let tasks = terms(check).flat_map(|term| of(&loaded.table, *term)).map(|(task, _)| task);
            CheckState { elsewhere: tasks.into_iter().find(is_elsewhere), ..CheckState::default() }
        };
        Self {
            stand: asks.iter().map(|asks| vec![None; asks.len()]).collect(),
            unknown: vec![None; asks.len()],
            states: loaded.checks.iter().map(state).collect(),
            vouched: Vouched::new(cell.nodes.len()),
            changes: BTreeMap::new(),
            came: 0,
            told: told.collect(),
            killed: vec![None; cell.nodes.len()],
            over: u64::MAX,
            settled: 0,
            missing: vec![None; cell.nodes.len()],
            loaded,
            asks,
        }
    }

    /// Takes a change of a task's values, as its node reported it.
    pub fn change(&mut self, change: Change) {
        self.push(change.at, Event::Change(change));
    }

    fn push(&mut self, at: u64, event: Event) {
        if self.changes.len() >= WAITING && matches!(event, Event::Change(_)) {
            self.drop_changes();
        }
        self.changes.insert((at, self.came), event);
        self.came += 1;
    }

    /// Drops pending changes to make room. Pending events of nodes and commands stay, because they are not repeated. If a change
    /// of a task is dropped, the task's values are unknown until its next change.
    fn drop_changes(&mut self) {
        let mut tasks = BTreeSet::new();
        self.changes.retain(|_, event| match event {
            Event::Change(change) => {
                tasks.insert(change.task);
                false
            }
            _ => true,
        });
        for task in tasks {
            self.forget(task, Doubt::Dropped);
            if let Some(node) = self.loaded.table.location(task) {
                self.missing[node.index()] = Some(Doubt::Dropped);
            }
        }
        self.look(self.settled);
    }

    /// Marks the values of a task as unknown, for this reason.
    fn forget(&mut self, task: TaskId, why: Doubt) {
        self.stand[task.index()].fill(None);
        self.unknown[task.index()] = Some(why);
    }

    /// Notes that a node has reported all events before `until`.
    pub fn told(&mut self, node: NodeId, until: u64) {
        if let Some(Some(told)) = self.told.get_mut(node.index()) {
            *told = until.max(*told);
        }
    }

    /// Notes that a running node could not report some changes since this instant. The values of each of its tasks are known
    /// again at the task's next change.
    pub fn untold(&mut self, node: NodeId, since: u64) {
        if let Some(missing) = self.missing.get_mut(node.index()) {
            missing.get_or_insert(Doubt::Untold(node));
        }
        self.push(since, Event::Untold(node));
    }

    /// Notes that a node was killed. The last messages of the node may still arrive.
    pub fn killed(&mut self, node: NodeId, at: u64) {
        if let Some(killed) = self.killed.get_mut(node.index()) {
            killed.get_or_insert(at);
        }
    }

    /// Notes that the pipe of a node has ended. Acts of the node after its last report are unknown, unless
    /// that was its final report.
    pub fn gone(&mut self, node: NodeId) {
        let until = self.told.get_mut(node.index()).and_then(|told| told.replace(u64::MAX));
        let Some(until) = until.filter(|until| *until < u64::MAX) else { return };
        let loaded = self.loaded;
        let is_lost =
            |change: &Change| loaded.table.location(change.task) == Some(node) && change.at >= until;
        self.changes.retain(|_, event| !matches!(event, Event::Change(change) if is_lost(change)));
        self.push(until, Event::Unknown(node));
        if let Some(at) = self.killed[node.index()] {
            self.push(at.max(until), Event::Dead(node));
        }
    }

    /// Takes a notice of a node or a guard about a command.
    pub fn notice(&mut self, notice: Notice) {
        let (key, at, event) = match notice {
            Notice::Began { key, task, at } => {
                let tasks = &self.loaded.table.cell().tasks;
                let Some(task) = tasks.iter().position(|of| of.name == task) else { return };
                (key, at, CommandEvent::Began(TaskId::from_index(task)))
            }
            Notice::Ended { key, at } => (key, at, CommandEvent::Ended),
            Notice::Lost { key, at } => (key, at, CommandEvent::Lost),
        };
        self.push(at, Event::Command(key, event));
    }

    /// Notes that all nodes have reported everything.
    pub fn all_told(&mut self) {
        self.told.iter_mut().flatten().for_each(|told| *told = u64::MAX);
    }

    /// Notes that a killed node was restarted.
    pub fn revived(&mut self, node: NodeId, at: u64) {
        self.gone(node);
        self.push(at, Event::Back(node));
        self.killed[node.index()] = None;
        self.told[node.index()] = Some(at);
    }

    /// Ends the run at this instant: later events are not judged.
    pub fn over(&mut self, at: u64) {
        self.over = self.over.min(at);
    }

    /// Judges up to the instant before which all nodes have reported everything. Returns new breaks, at most `TOLD` per check.
    pub fn settle(&mut self) -> Vec<Broken> {
        let until = self.told.iter().flatten().copied().min().unwrap_or(u64::MAX).min(self.over);
        let mut broken = Vec::new();
        while let Some(entry) = self.changes.first_entry().filter(|entry| entry.key().0 < until) {
            let ((at, _), event) = entry.remove_entry();
            let at = at.max(self.settled);
            self.pass(at, &mut broken);
            self.take(event);
            self.look(at);
        }
        if until < u64::MAX {
            self.pass(until.max(self.settled), &mut broken);
        }
        broken
    }

    /// Whether changes are missing that should have been judged.
    pub fn is_missing(&self) -> bool {
        self.missing.iter().any(Option::is_some)
    }

    /// For how long it is unknown whether a check held, and the main reason. While changes are missing, the check may be broken.
    fn unvouched(&self, check: usize) -> Option<(Doubt, u64)> {
        let state = &self.states[check];
        state.unvouched().or_else(|| {
            let asked = terms(&self.loaded.checks[check]).flat_map(|term| of(&self.loaded.table, *term));
            let nodes = asked.filter_map(|(task, _)| self.loaded.table.location(task));
            let doubt = nodes.filter_map(|node| self.missing[node.index()]).min()?;
            Some((doubt, state.doubted.get(&doubt).copied().unwrap_or_default()))
        })
    }

    /// Returns the verdicts on all checks.
    pub fn settlement(&self, began: u64) -> Settlement {
        let settled = |(at, state): (usize, &CheckState)| {
            let unvouched = self.unvouched(at);
            let outcome = match (state.elsewhere, state.judged) {
                _ if state.times > 0 => Outcome::Broken,
                (Some(_), _) => Outcome::Elsewhere,
                (None, false) => Outcome::Unknown,
                (None, true) if unvouched.is_some() => Outcome::Unknown,
                (None, true) if self.leads(at) && state.mattered == 0 => Outcome::Untested,
                (None, true) => Outcome::Held,
            };
            let unvouched = unvouched.filter(|_| outcome == Outcome::Unknown);
            let unvouched = unvouched.map(|(doubt, length)| Unvouched::new(self.loaded, doubt, length));
            let name = |task: TaskId| self.loaded.table.cell().tasks[task.index()].name.clone();
            let (mattered, elsewhere) = (self.leads(at).then_some(state.mattered), state.elsewhere.map(name));
            Settled::new(
                self.loaded,
                at,
                outcome,
                (mattered, state.times),
                state.broken.first(),
                (elsewhere, unvouched),
                began,
            )
        };
        Settlement(self.states.iter().enumerate().map(settled).collect())
    }

    fn leads(&self, check: usize) -> bool {
        matches!(self.loaded.checks[check].kind, CheckKind::Leads { .. })
    }

    /// Advances the judgement to `until`; no value changes in this time. Notes the checks that are broken during it,
    /// and the `leads` checks whose time limit ends before `until`.
    fn pass(&mut self, until: u64, broken: &mut Vec<Broken>) {
        let length = until.saturating_sub(std::mem::replace(&mut self.settled, until));
        for check in 0..self.states.len() {
            let state = &mut self.states[check];
            if let Some(doubt) = state.doubt {
                *state.doubted.entry(doubt).or_default() += length;
            }
            let state = &self.states[check];
            let late = state.due.filter(|&(_, late)| late < until);
            let found = match (&state.since, late) {
                (Some((at, values)), _) if !state.is_told && until > at + READING => {
                    Some(Broken { check, at: *at, since: None, values: values.clone() })
                }
                (_, Some((since, at))) => {
                    Some(Broken { check, at, since: Some(since), values: self.values(check) })
                }
                (_, None) => None,
            };
            let Some(found) = found else { continue };
            let state = &mut self.states[check];
            (state.due, state.is_told) = (None, true);
            state.times += 1;
            if state.broken.len() < TOLD {
                state.broken.push(found.clone());
                broken.push(found);
            }
        }
    }

    fn take(&mut self, event: Event) {
        let loaded = self.loaded;
        let table = &loaded.table;
        match event {
            Event::Change(Change { task, values, .. }) => self.stands(task, &values),
            Event::Unknown(node) => {
                table.tasks_on(node).for_each(|task| self.forget(task, Doubt::Silent(node)));
                self.vouched.silent(node, table.tasks_on(node));
            }
            // The node runs, so it still controls its commands.
            Event::Untold(node) => {
                table.tasks_on(node).for_each(|task| self.forget(task, Doubt::Untold(node)));
            }
            Event::Dead(node) => {
                for task in table.tasks_on(node) {
                    self.stand[task.index()] = dead(loaded, (task, &self.asks[task.index()]));
                    self.unknown[task.index()] = Some(Doubt::Dead(node));
                }
                self.vouched.silent(node, table.tasks_on(node));
            }
            Event::Back(node) => self.vouched.back(node),
            Event::Command(key, event) => {
                self.vouched.command(key, &event, |task| table.location(task));
            }
        }
    }

    /// Stores the reported values of a task.
    fn stands(&mut self, task: TaskId, values: &[i64]) {
        let known = self.stand.get_mut(task.index()).zip(self.asks.get(task.index()));
        let Some((stand, asks)) = known else { return };
        *stand = (0..asks.len()).map(|at| values.get(at).copied()).collect();
        self.unknown[task.index()] = None;
        // A task that is not active any more does not control its command that still runs.
        if asks.iter().zip(values).any(|(ask, value)| *ask == Ask::Active && *value == 0) {
            self.vouched.inactive(task);
        }
    }
}

#[cfg(test)]
mod tests;
