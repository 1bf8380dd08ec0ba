//! The plan of a check: the cell, its tasks, checks, faults and budgets.

use super::legend::Legend;
use imrs_protocol::script::{Op, Predicate, Program, Term};
use imrs_protocol::{CellTable, NodeId, Rate, TaskId, Ticks};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The default of [`CellPlan::zones`]. In searches of the examples, fewer zones cost time as often as they save it.
const MOST_ZONES: usize = 64;

/// What a task does.
#[derive(Clone, Debug)]
pub enum Conduct {
    /// The task runs a program.
    Program {
        /// The program, whose durations are in ticks.
        program: Arc<Program>,
        /// For each action of the program, the results worth trying. An action without such results gives 0.
        values: Vec<Vec<i32>>,
        /// Whether other results of the program's actions, which are not tried, may lead to other statements.
        open: bool,
    },
    /// The body of the task is outside the cell: the task makes any legal use of its ports, at most at this rate.
    Extern(Option<Rate>),
}

/// A hypothesis of faults: the most faults of each kind.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellFaults {
    /// The number of packets that are lost.
    pub loss: u8,
    /// The number of packets that arrive twice.
    pub dup: u8,
    /// The number of packets that overtake a packet that was sent earlier on their link.
    pub reorder: u8,
    /// The number of actions that fail.
    pub fail: u8,
    /// The number of ticks that the clock of some node leaves out or counts twice.
    pub drift: u8,
    /// Nodes that crash, one entry for each crash.
    pub crash: Vec<NodeId>,
    /// Links that are cut for a while, one entry for each cut: positions in [`Cell::links`](imrs_protocol::Cell).
    pub cut: Vec<usize>,
    /// Nodes that pause, one entry for each pause.
    pub pause: Vec<Pause>,
}

/// A pause of a node, which takes no step for a while, as when its process is stopped (SIGSTOP) or not scheduled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// The node that pauses; `None` stands for any node.
    pub node: Option<NodeId>,
    /// The greatest length of the pause in ticks, counted from the first step that the node misses.
    pub most: u32,
}

impl Pause {
    /// A pause of this node, or of any node, of at most `most` ticks. `None`: one tick longer than the longest time_out or
    /// take-over of the cell: then every wait for the node that is open when the pause begins is over before the pause
    /// ends.
    #[must_use]
    pub fn new(table: &CellTable, node: Option<NodeId>, most: Option<Ticks>) -> Self {
        let parties = table.ports().iter().flat_map(|port| &port.parties);
        let waits = parties.map(|party| party.time_out).filter(|length| *length < Ticks::FAR);
        let takeovers = table.cell().couples.iter().map(|couple| couple.takeover);
        let longest = || Ticks(waits.chain(takeovers).max().map_or(1, |longest| longest.0 + 1));
        let most = most.unwrap_or_else(longest).0.max(1);
        Self { node, most: u32::try_from(most).unwrap_or(u32::MAX - 1) }
    }

    /// Whether this pause may happen to this node.
    pub(super) fn is_of(&self, node: usize) -> bool {
        self.node.is_none_or(|of| of.index() == node)
    }
}

impl CellFaults {
    /// Whether independent parts may be searched one by one: not if clocks may drift or nodes may pause, because drifts and
    /// pauses happen between events of the whole cell.
    pub(super) const fn may_be_apart(&self) -> bool {
        !self.disturb_time()
    }

    /// Whether clocks may drift or nodes may pause. A search by zones does not cover these faults.
    #[must_use]
    pub const fn disturb_time(&self) -> bool {
        self.drift > 0 || !self.pause.is_empty()
    }

    /// Whether a lookup by the fault budgets may miss the kept state that covers a state. A search omits the loss of a packet that no
    /// task would notice. The state that is kept instead may allow more moves than its fault budgets show: an unused cut allows what
    /// an open one does, and a packet that arrived at a node that is down may restart it.
    pub(super) const fn hide_covered_states(&self) -> bool {
        let doubles = self.dup > 0 || self.reorder > 0;
        let takes = self.loss > 0 || !self.cut.is_empty();
        !self.cut.is_empty() && doubles || takes && !self.crash.is_empty()
    }

    /// Whether no fault may happen.
    #[must_use]
    pub fn are_none(&self) -> bool {
        *self == Self::default()
    }

    /// How many kinds of faults may happen: losses, crashes, cuts, ...
    #[must_use]
    pub fn kinds(&self) -> usize {
        let counted = [self.loss, self.dup, self.reorder, self.fail, self.drift].map(|had| had > 0);
        let listed = [self.crash.is_empty(), self.cut.is_empty(), self.pause.is_empty()].map(|none| !none);
        counted.into_iter().chain(listed).filter(|&has| has).count()
    }
}

/// What a check demands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Holds {
    /// The expression is true in every state.
    Always(Vec<Term>),
    /// Whenever `when` is true, `then` becomes true, at once or within the bound.
    Leads {
        /// The left side of the check.
        when: Vec<Term>,
        /// The right side of the check.
        then: Vec<Term>,
        /// The longest time from the left side to the right side.
        within: Ticks,
    },
}

/// A check of the cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellCheck {
    /// The check's name.
    pub name: String,
    /// What the check demands.
    pub holds: Holds,
}

/// Limits of the search, for each phase and each independent part. [`Coverage`](super::Coverage) tells which limit ended it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// The greatest number of states that are kept.
    pub states: u64,
    /// The longest time in seconds.
    pub seconds: f64,
    /// The greatest resident memory of the whole process, in bytes.
    pub bytes: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { states: u64::MAX, seconds: 30.0, bytes: 4 << 30 }
    }
}

impl Budget {
    /// Says that the time ended a search.
    pub(super) fn out_of_time(&self) -> String {
        format!("out of time ({} s)", (self.seconds * 1000.0).round() / 1000.0)
    }

    /// Says that the memory ended a search.
    pub(super) fn out_of_memory(&self) -> String {
        format!("out of memory ({} MiB)", self.bytes >> 20)
    }
}

/// The times that a search tries for the ends of actions, from their least to their most time, and for the arrivals of
/// packets, from one tick to their link's bound.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Times {
    /// Tries all times first, and [`Ends`](Self::Ends) if that does not finish within three quarters of the budget's
    /// seconds. All times are tried as [`Every`](Self::Every), up to [`AUTO_STATES`](Self::AUTO_STATES) states, or
    /// [`AUTO_STATES_WITH_FAULTS`](Self::AUTO_STATES_WITH_FAULTS) with faults; then as [`Zones`](Self::Zones). Zones do
    /// not cover pauses and drift: then `Every` and [`Between`](Self::Between) are tried.
    #[default]
    Auto,
    /// Actions end at their least or most time, packets arrive at their bound.
    Ends,
    /// Actions also end, and packets also arrive, right after any other event in the same independent part of the cell,
    /// within their declared times.
    Between,
    /// Actions end and packets arrive at every tick of their declared times; with a [`CellPlan::step`] above 1, only at
    /// some of these ticks.
    Every,
    /// As with `Every`, but the search uses zones: sets of times at which the same happens.
    Zones,
}

impl Times {
    /// The most states that a search at finer event times may take without faults, before coarser times are tried.
    pub const AUTO_STATES: u64 = 30_000;
    /// The most states that a search at finer event times may take with faults, before coarser times are tried.
    pub const AUTO_STATES_WITH_FAULTS: u64 = 8_000;
}

/// A cell to check.
#[derive(Clone, Debug)]
pub struct CellPlan {
    /// The cell's table, with durations in ticks.
    pub table: Arc<CellTable>,
    /// What each task does, by position.
    pub tasks: Vec<Conduct>,
    /// Hypotheses of faults, each searched by itself.
    pub faults: Vec<CellFaults>,
    /// The checks.
    pub checks: Vec<CellCheck>,
    /// The limits of each search.
    pub budget: Budget,
    /// When actions may end and packets may arrive.
    pub times: Times,
    /// The distance between the ticks that [`Times::Every`] tries, counted back from the most time. A search by zones covers
    /// every tick, whatever this distance is.
    pub step: u32,
    /// Switches off all reductions, to check that they change no finding. The search then also tries faults that no task
    /// notices, keeps covered states and dead variables, tries crashes, restarts and pauses at every event, and searches
    /// all independent parts together.
    pub everything: bool,
    /// The greatest number of zones that a search by zones keeps for one control (a state without its times). If there
    /// would be more, the search keeps the least zone that includes them all, their *hull*.
    pub zones: usize,
    /// How many packets a node's transit buffer holds.
    pub transit: u16,
    /// Threads that search.
    pub jobs: usize,
    /// What charts show of the cell's text. The verdict does not depend on it.
    pub legend: Legend,
    /// The tasks whose bodies are outside the cell. `outside::with_programs` gave them programs that try any use of
    /// their ports.
    pub(super) outside: Vec<usize>,
    /// The independent part that is searched; `None` stands for the whole cell.
    pub(super) part: Option<Part>,
}

impl CellPlan {
    /// A plan for a cell without faults and checks.
    #[must_use]
    pub fn new(table: Arc<CellTable>, tasks: Vec<Conduct>) -> Self {
        Self {
            table,
            tasks,
            faults: Vec::new(),
            checks: Vec::new(),
            budget: Budget::default(),
            times: Times::Auto,
            step: 1,
            everything: false,
            zones: MOST_ZONES,
            transit: 16,
            jobs: 1,
            legend: Legend::default(),
            outside: Vec::new(),
            part: None,
        }
    }

    /// A copy of the plan with other event times.
    pub(super) fn timed(&self, times: Times) -> Arc<Self> {
        Arc::new(Self { times, ..self.clone() })
    }

    /// The distance between the ticks that the plan's times allow.
    pub(super) fn tick_step(&self) -> u32 {
        if self.times == Times::Zones { 1 } else { self.step }
    }

    /// Whether the body of some task is outside the cell.
    #[must_use]
    pub fn has_extern(&self) -> bool {
        self.tasks.iter().any(|task| matches!(task, Conduct::Extern(_)))
    }

    /// Whether some action has results other than 0 and 1.
    #[must_use]
    pub fn takes_numbers(&self) -> bool {
        let numbers = |values: &Vec<i32>| !values.is_empty() && values[..] != [0, 1];
        let takes =
            |task: &Conduct| matches!(task, Conduct::Program { values, .. } if values.iter().any(numbers));
        self.tasks.iter().any(takes)
    }

    /// Whether actions may give results that the search does not try.
    #[must_use]
    pub fn has_open_results(&self) -> bool {
        self.tasks.iter().any(|task| matches!(task, Conduct::Program { open: true, .. }))
    }

    /// Whether every action and every packet has only one possible duration.
    pub(super) fn is_exact(&self) -> bool {
        let exact = |conduct: &Conduct| match conduct {
            Conduct::Program { program, .. } => {
                program.code.iter().all(|op| !matches!(op, Op::Run { least, most, .. } if least < most))
            }
            Conduct::Extern(_) => true,
        };
        self.tasks.iter().enumerate().all(|(task, conduct)| !self.has_task(task) || exact(conduct))
            && self.table.cell().links.iter().all(|link| !self.has_node(link.a.index()) || link.delay.0 <= 1)
    }

    /// Whether a node is in the searched part.
    pub(super) fn has_node(&self, node: usize) -> bool {
        self.part.as_ref().is_none_or(|part| part.has_node(node))
    }

    pub(super) fn has_task(&self, task: usize) -> bool {
        self.part.is_none() || self.has_node(node_of(&self.table, task))
    }

    pub(super) fn has_check(&self, check: usize) -> bool {
        self.part.as_ref().is_none_or(|part| part.has_check(check))
    }

    /// The terms that a check reads; for a `leads` check, the terms of both sides.
    pub(super) fn terms(&self, check: usize) -> Vec<Term> {
        let looks = |term: &Term| matches!(term, Term::Of { .. } | Term::Is(_));
        let mut all: Vec<Term> = Vec::new();
        let Some(check) = self.checks.get(check) else { return all };
        let both = match &check.holds {
            Holds::Always(terms) => [&terms[..], &[]],
            Holds::Leads { when, then, .. } => [&when[..], &then[..]],
        };
        for term in both.into_iter().flatten().filter(|term| looks(term)) {
            if !all.contains(term) {
                all.push(*term);
            }
        }
        all
    }
}

/// The task that a term of a check reads.
pub(super) fn about(term: &Term) -> Option<usize> {
    match *term {
        Term::Of { task, .. }
        | Term::Is(
            Predicate::Active(task)
            | Predicate::Arrived { task, .. }
            | Predicate::Asked { task, .. }
            | Predicate::Answered { task, .. },
        ) => Some(task.index()),
        _ => None,
    }
}

/// An independent part of a cell: nodes that no packet and no check connects with the other nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// The part's position among the parts of the cell.
    pub number: usize,
    /// The part's nodes, as a bit set.
    pub nodes: u64,
    pub checks: Vec<bool>,
}

impl Part {
    pub const fn has_node(&self, node: usize) -> bool {
        node < 64 && self.nodes >> node & 1 == 1
    }

    pub fn has_check(&self, check: usize) -> bool {
        self.checks.get(check).copied().unwrap_or(false)
    }

    /// The nodes outside of the part, as a bit set.
    pub const fn left_out(&self) -> u64 {
        !self.nodes
    }

    /// Whether a fault of this hypothesis can happen in the part.
    pub fn is_touched_by(&self, plan: &CellPlan, faults: &CellFaults) -> bool {
        let cell = plan.table.cell();
        let links = faults.cut.iter().filter_map(|&link| cell.links.get(link));
        [faults.loss, faults.dup, faults.reorder, faults.fail, faults.drift].iter().any(|&budget| budget > 0)
            || faults.crash.iter().any(|node| self.has_node(node.index()))
            || faults.pause.iter().any(|pause| pause.node.is_none_or(|node| self.has_node(node.index())))
            || links.into_iter().any(|link| self.has_node(link.a.index()) && self.has_node(link.b.index()))
    }
}

/// The node of a task.
pub(super) fn node_of(table: &CellTable, task: usize) -> usize {
    table.location(TaskId::from_index(task)).map_or(0, NodeId::index)
}
