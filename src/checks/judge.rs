//! Judges the checks by the changes that the nodes of a run reported, in the order of their times.

use super::told::{Outcome, Settled, Settlement, Unvouched};
use super::vouch::{CommandEvent, Doubt, Vouched};
use super::{Ask, Change, asks, of, terms};
use crate::cells::Loaded;
use imrs_language::lower::CheckKind;
use imrs_protocol::script::{Predicate, Term, Type, eval};
use imrs_protocol::{NodeId, PortId, Round, TaskId};
use imrs_runtime::guard::Notice;
use std::collections::{BTreeMap, BTreeSet};

/// Resolution in microseconds of the order of two steps on different nodes: each time is rounded up to a whole microsecond. A
/// state that lasted no longer may never have existed.
const READING: u64 = 1;
/// How many events may wait for a silent node. Beyond that, waiting changes are dropped.
const WAITING: usize = if cfg!(test) { 64 } else { 1 << 20 };
/// Longest silence before a kill that does not count, in microseconds: a node reports every 20 ms, or later if busy.
const LAST_WORDS: u64 = 1_000_000;
/// Up to so many unknown truth values a check is still evaluated, with each of them true and false.
const MOST_OPEN: usize = 6;
/// How many breaks of each check are reported in detail.
const TOLD: usize = 3;

/// Judges the checks of a run.
pub struct Judge<'a> {
    loaded: &'a Loaded,
    /// For each task, the values that checks read.
    asks: Vec<Vec<Ask>>,
    /// For each task, these values; `None` if a value is not known.
    stand: Vec<Vec<Option<i64>>>,
    /// For each task, why values of it are not known; `None` while its node reports all of them, and before its first report.
    unknown: Vec<Option<Doubt>>,
    /// The state of each check.
    states: Vec<CheckState>,
    vouched: Vouched,
    /// Pending events by time, then by the order in which they came.
    changes: BTreeMap<(u64, u64), Event>,
    came: u64,
    /// For each node, the instant up to which it has reported everything; `None` if it does not report here.
    told: Vec<Option<u64>>,
    /// For each node, when it was killed, until its pipe has ended.
    killed: Vec<Option<u64>>,
    /// The first instant after the run.
    over: u64,
    settled: u64,
    /// For each node, why changes of its tasks are missing.
    missing: Vec<Option<Doubt>>,
}

enum Event {
    Change(Change),
    /// The node reports nothing any more.
    Unknown(NodeId),
    /// The node lives, but could not report all changes from now on.
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
    /// The first of its tasks whose node does not report here.
    elsewhere: Option<TaskId>,
    /// Whether it could be evaluated at any time so far.
    judged: bool,
    /// For `leads`: how often its condition came, and whether it is true now.
    mattered: u64,
    matters: bool,
    /// Since when an `always` or `never` is broken, and the values then.
    since: Option<(u64, Vec<String>)>,
    /// Why it is unknown whether it holds now.
    doubt: Option<Doubt>,
    /// For how long that was unknown, by reason.
    doubted: BTreeMap<Doubt, u64>,
    /// Whether the current break has been reported.
    is_told: bool,
    /// For `leads`: since when the second condition is awaited, and when it is late.
    due: Option<(u64, u64)>,
    times: u64,
    broken: Vec<Broken>,
}

impl CheckState {
    /// For how long it is unknown whether the check held, and the main reason. The last messages of a killed node are always
    /// missing: that alone does not count.
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
    /// When, in microseconds of the clock that all nodes share.
    pub at: u64,
    /// For `leads`: since when the second condition was awaited.
    pub since: Option<u64>,
    /// The values that the check reads: `armL.me.moving = true`.
    pub values: Vec<String>,
}

impl<'a> Judge<'a> {
    /// A run in which these nodes report, without any events yet.
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

    /// Takes a change of a task's values.
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

    /// Drops pending changes to make room. Events of nodes and commands stay, because they are not repeated. A task that loses a
    /// change is unknown until its next one.
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

    /// A node has reported everything before this instant.
    pub fn told(&mut self, node: NodeId, until: u64) {
        if let Some(Some(told)) = self.told.get_mut(node.index()) {
            *told = until.max(*told);
        }
    }

    /// A live node could not report some changes since this instant. Each of its tasks is known again at its next change.
    pub fn untold(&mut self, node: NodeId, since: u64) {
        if let Some(missing) = self.missing.get_mut(node.index()) {
            missing.get_or_insert(Doubt::Untold(node));
        }
        self.push(since, Event::Untold(node));
    }

    /// A node was killed. Its last messages may still come.
    pub fn killed(&mut self, node: NodeId, at: u64) {
        if let Some(killed) = self.killed.get_mut(node.index()) {
            killed.get_or_insert(at);
        }
    }

    /// The pipe of a node has ended. What the node did after its last report is unknown, unless it had reported everything.
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

    /// All nodes have reported everything.
    pub fn all_told(&mut self) {
        self.told.iter_mut().flatten().for_each(|told| *told = u64::MAX);
    }

    /// A killed node was restarted.
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

    /// Whether changes that should have been judged are missing.
    pub fn is_missing(&self) -> bool {
        self.missing.iter().any(Option::is_some)
    }

    /// For how long it is unknown whether a check held, and why. While changes are missing, it may have been broken.
    fn unvouched(&self, check: usize) -> Option<(Doubt, u64)> {
        let state = &self.states[check];
        state.unvouched().or_else(|| {
            let asked = terms(&self.loaded.checks[check]).flat_map(|term| of(&self.loaded.table, *term));
            let nodes = asked.filter_map(|(task, _)| self.loaded.table.location(task));
            let doubt = nodes.filter_map(|node| self.missing[node.index()]).min()?;
            Some((doubt, state.doubted.get(&doubt).copied().unwrap_or_default()))
        })
    }

    /// The verdicts on all checks.
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

    /// Lets time pass until `until` without a change, and notes breaks that last or come due.
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
            // The node lives, and still controls its commands.
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
        // A task that may no longer act does not control a command that is still running.
        if asks.iter().zip(values).any(|(ask, value)| *ask == Ask::Active && *value == 0) {
            self.vouched.inactive(task);
        }
    }

    /// Evaluates all checks at this instant.
    fn look(&mut self, now: u64) {
        let loaded = self.loaded;
        for (at, check) in loaded.checks.iter().enumerate() {
            if self.states[at].elsewhere.is_some() {
                continue;
            }
            match &check.kind {
                CheckKind::Always(terms) => {
                    let holds = self.is(terms);
                    let doubt = if holds.is_none() { self.doubts(terms).min() } else { None };
                    let starts = holds == Some(false) && self.states[at].since.is_none();
                    let values = starts.then(|| self.values(at));
                    let state = &mut self.states[at];
                    state.judged |= holds.is_some();
                    state.doubt = doubt.filter(|_| state.judged);
                    if let Some(values) = values {
                        state.since = Some((now, values));
                    } else if holds != Some(false) {
                        (state.since, state.is_told) = (None, false);
                    }
                }
                CheckKind::Leads { when, then, within } => {
                    let doubts = || self.doubts(when).chain(self.doubts(then)).filter(|doubt| doubt.lasts());
                    let (when, then) = (self.is(when), self.is(then));
                    let lasting = if when.and(then).is_none() { doubts().min() } else { None };
                    // A node may notice a deadline one tick late (D42).
                    let late = now.saturating_add(within.0 + loaded.table.cell().tick.0 + READING);
                    let state = &mut self.states[at];
                    state.judged |= when.is_some() && then.is_some();
                    state.mattered += u64::from(when == Some(true) && !state.matters);
                    state.matters = when == Some(true);
                    let is_open = match (when, then) {
                        (_, Some(true)) | (Some(_), Some(false)) => false,
                        (Some(false), None) => state.due.is_some(),
                        (None, _) | (Some(true), None) => true,
                    };
                    state.doubt = lasting.filter(|_| is_open && state.judged);
                    match (when, then) {
                        (_, None) => state.due = None,
                        (_, Some(true)) => (state.due, state.is_told) = (None, false),
                        (Some(true), Some(false)) if state.due.is_none() && !state.is_told => {
                            state.due = Some((now, late));
                        }
                        (Some(true) | None, Some(false)) => {}
                        (Some(false), Some(false)) => state.is_told = false,
                    }
                }
            }
        }
    }

    /// Whether an expression is true; `None` if that is not known.
    fn is(&self, terms: &[Term]) -> Option<bool> {
        // The unknown truth values. Bit `i` of `case` is the value that the `i`-th of them is assumed to have.
        let (mut open, mut case, mut found) = (Vec::new(), 0_u64, None);
        loop {
            let mut known = true;
            let value = eval(terms, |term| {
                let value = self.value(term);
                if value.is_none() && !open.contains(&term) && self.is_in_doubt(term) {
                    open.push(term);
                }
                let bit = open.iter().position(|of| *of == term);
                known &= value.is_some() || bit.is_some_and(|bit| bit < MOST_OPEN);
                value.or_else(|| bit.map(|bit| i64::from(case >> bit.min(MOST_OPEN) & 1 == 1)))
            });
            // As in the checker, an expression that cannot be computed is not true.
            let value = value.is_ok_and(|value| value != 0);
            if !known || found.replace(value).is_some_and(|before| before != value) {
                return None;
            }
            case += 1;
            if case >> open.len() != 0 {
                return found;
            }
        }
    }

    /// Whether a term is an unknown truth value. The check may still have the same result with both values.
    fn is_in_doubt(&self, term: Term) -> bool {
        if let Term::Of { task, variable } = term {
            let program = self.loaded.program(task);
            let of = program.and_then(|program| Some(program.variables.get(usize::from(variable))?.of));
            if of != Some(Type::Bool) {
                return false;
            }
        }
        of(&self.loaded.table, term).into_iter().any(|(task, _)| self.doubt_of(task).is_some())
    }

    /// Why values in an expression are not known.
    fn doubts(&self, terms: &[Term]) -> impl Iterator<Item = Doubt> {
        let unknown = terms.iter().filter(|term| self.value(**term).is_none());
        let tasks = unknown.flat_map(|term| of(&self.loaded.table, *term)).map(|(task, _)| task);
        tasks.filter_map(|task| self.doubt_of(task))
    }

    /// Why a value of a task may not be known.
    fn doubt_of(&self, task: TaskId) -> Option<Doubt> {
        if self.vouched.has_orphan(task) {
            return Some(Doubt::Command(task));
        }
        *self.unknown.get(task.index())?
    }

    fn value(&self, term: Term) -> Option<i64> {
        if let Term::Is(Predicate::Arrived { port, task }) = term {
            return self.has_arrived(port, task).map(i64::from);
        }
        let (task, ask) = of(&self.loaded.table, term).pop()?;
        self.seen(task, ask)
    }

    fn seen(&self, task: TaskId, ask: Ask) -> Option<i64> {
        // Whatever the node reported last, and even if it is dead, the command may still move the robot.
        if self.vouched.has_orphan(task) {
            return None;
        }
        let at = self.asks[task.index()].iter().position(|one| *one == ask)?;
        *self.stand[task.index()].get(at)?
    }

    /// Whether the task has reached the waitfor, and no party has begun a later round there since (D85).
    fn has_arrived(&self, port: PortId, task: TaskId) -> Option<bool> {
        let (mut newest, mut own) = (None, None);
        for party in &self.loaded.table.port(port)?.parties {
            let seen = self.seen(party.task, Ask::Arrived(port))?;
            let Ok(seen) = u32::try_from(seen) else { continue };
            let round = u16::try_from(seen.wrapping_sub(1)).ok().map(Round);
            newest = round.into_iter().chain(newest).reduce(Round::fresher);
            if party.task == task {
                own = Some(round);
            }
        }
        Some(own.is_some_and(|round| round.is_none() || round == newest))
    }

    /// The values that a check reads, as text.
    fn values(&self, check: usize) -> Vec<String> {
        let mut words = Vec::new();
        for term in terms(&self.loaded.checks[check]) {
            let Some(name) = self.loaded.term(*term) else { continue };
            let value =
                self.value(*term).map_or_else(|| "unknown".into(), |value| self.loaded.shown(*term, value));
            let word = format!("{name} = {value}");
            if !words.contains(&word) {
                words.push(word);
            }
        }
        words
    }
}

/// The values of a task on a dead node, as in the checker: initial variables, no activity. Whether it still counts as arrived
/// is unknown, because the others may have moved on.
fn dead(loaded: &Loaded, (task, asks): (TaskId, &[Ask])) -> Vec<Option<i64>> {
    let program = loaded.program(task);
    let value = |ask: &Ask| match ask {
        Ask::Variable(at) => Some(program?.variables.get(usize::from(*at))?.initial),
        Ask::Active | Ask::Asked(_) | Ask::Answered(_) => Some(0),
        Ask::Arrived(_) => None,
    };
    asks.iter().map(value).collect()
}

#[cfg(test)]
mod tests;
