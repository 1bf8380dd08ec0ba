//! The verdicts of a check: findings, warnings and coverage.

use super::plan::Times;
use super::run_state::CellMove;
use super::values::Tried;
use crate::chart::Note;
use imrs_protocol::script::Address;
use imrs_protocol::{NodeId, PortId, TaskId};
use serde::{Deserialize, Serialize};

/// The kind of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Kind {
    /// Tasks wait for each other for ever, even if other tasks go on.
    Deadlock,
    /// A request ends by its time_out without a fault.
    TimeOut,
    /// A request is rejected or bypassed more often than aging allows, without a fault (D58).
    Starves,
    /// A member waits at a `waitfor` until its time_out, without a fault.
    Stranded,
    /// A message is refused without a fault.
    Refused,
    /// A statement ends badly and has no branch for this outcome, so its task ends.
    Ends,
    /// A task reaches an `abort` without a fault.
    Aborts,
    /// A primary loses its lease although no fault happened.
    LeaseLost,
    /// An `assert` does not hold.
    Assertion,
    /// A script ends in a fault.
    ScriptFault,
    /// A check does not hold.
    Check,
    /// Both tasks of a work couple act (D61).
    TwoOwners,
    /// A statement is never reached.
    Unreached,
    /// A `leads` check never applies: its left side is never true.
    Vacuous,
    /// Tasks go on for ever without progress (livelock): a warning.
    Standstill,
    /// A task waits for ever, because all tasks that could help have ended or wait themselves: a warning.
    WaitsForEver,
    /// The protocol's state machine violates an invariant, or a state has no packed form.
    Machine,
}

impl Kind {
    /// Whether findings of this kind may be intended: these are warnings, and no check fails because of them.
    #[must_use]
    pub const fn is_warning(self) -> bool {
        matches!(self, Self::Standstill | Self::WaitsForEver)
    }

    /// A heading of a few words for findings of this kind.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Deadlock => "deadlock",
            Self::TimeOut => "time_out without a fault",
            Self::Starves => "starvation",
            Self::Stranded => "waits in vain without a fault",
            Self::Refused => "refused without a fault",
            Self::Ends => "ends the task",
            Self::Aborts => "aborts without a fault",
            Self::LeaseLost => "lease lost without a fault",
            Self::Assertion => "assertion",
            Self::ScriptFault => "fault of the script",
            Self::Check => "check",
            Self::TwoOwners => "two owners",
            Self::Unreached => "never reached",
            Self::Vacuous => "check says nothing",
            Self::Standstill => "standstill",
            Self::WaitsForEver => "waits for ever",
            Self::Machine => "fault of the machine",
        }
    }
}

/// A phase of checking a cell: one search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// The search without faults.
    FaultFree,
    /// A search with the faults of one hypothesis.
    Faults,
}

/// A task that a finding concerns, and what the task does at that time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Concerned {
    /// The task that is concerned.
    pub task: TaskId,
    /// The operation at which the task is or was last; `None` if the task has begun no statement.
    pub at: Option<Address>,
    /// What the task does, in words.
    pub does: String,
}

/// Something on a path that takes an uncertain time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Timed {
    /// An action of a task.
    Action {
        /// The task.
        task: TaskId,
        /// The name of the action.
        name: String,
    },
    /// A packet on a link.
    Packet {
        /// The port of its message.
        port: PortId,
        /// The node that sends the packet over the link.
        from: NodeId,
        /// The node at which the packet arrives.
        to: NodeId,
    },
}

/// The times, in ticks, that an action or a packet takes when a path happens. Each of these times is possible, some only together with certain
/// times of other actions and packets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeRange {
    /// What takes the time.
    pub timed: Timed,
    /// The least time.
    pub least: u64,
    /// The greatest time; `None`: the action need not end.
    pub most: Option<u64>,
    /// The least time that the cell declares. The next field has the greatest.
    pub declared_least: u64,
    /// The greatest time that the cell declares.
    pub declared_most: Option<u64>,
    /// Whether the action or the packet is over at the finding.
    pub has_ended: bool,
}

impl TimeRange {
    /// The declared time next to `ticks`: the longer or (`false`) the shorter one; `None` if there is none.
    pub(super) fn beyond(&self, ticks: u64, is_longer: bool) -> Option<u64> {
        let next = if is_longer { ticks.checked_add(1) } else { ticks.checked_sub(1) };
        next.filter(|&next| next >= self.declared_least && self.declared_most.is_none_or(|most| next <= most))
    }

    /// Whether the path excludes a declared time.
    #[must_use]
    pub fn is_narrowed(&self) -> bool {
        (self.least, self.most) != (self.declared_least, self.declared_most)
    }
}

/// Something that is wrong, and the shortest path to it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finding {
    /// The kind of the finding.
    pub kind: Kind,
    /// The phase in which the finding was made, which shows whether the finding needs a fault.
    pub phase: Phase,
    /// In a phase with faults: the position of the phase's fault hypothesis in the plan.
    pub hypothesis: usize,
    /// The event times of the search that made the finding.
    pub times: Times,
    /// The position of the independent part in which the finding was made; `None`: the cell was searched as a whole.
    #[serde(default)]
    pub part: Option<usize>,
    /// The task to which the finding belongs.
    pub task: Option<TaskId>,
    /// Other tasks with the same statements, each with the same finding.
    #[serde(default)]
    pub also: Vec<TaskId>,
    /// The operation of the task's program at which the finding was made.
    pub address: Option<Address>,
    /// The check that the finding is about, by its position.
    pub check: Option<usize>,
    /// The work couple that the finding is about, by its position among the cell's couples.
    pub couple: Option<usize>,
    /// The other tasks that the finding concerns.
    pub others: Vec<Concerned>,
    /// The cause of the finding: one line, in the names of the cell.
    pub cause: String,
    /// Ticks from the start to the finding.
    pub at_ticks: u64,
    /// For which times of its actions and packets the same path happens: the uncertain times in the order in which they end, and then
    /// those that have not ended at the finding. Empty if the path has none, or if they are not known.
    #[serde(default)]
    pub ranges: Vec<TimeRange>,
    /// The moves that lead to the finding. They can be replayed with the same plan.
    pub moves: Vec<CellMove>,
    /// The steps of the path: the same moves, with what they show.
    pub steps: Vec<Step>,
    /// The path as a sequence chart of at most 78 columns, in which repetitions are drawn once.
    pub chart: String,
}

/// What one phase of the check has covered.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Coverage {
    /// The phase that was searched.
    pub phase: Phase,
    /// In a phase with faults: the position of the phase's fault hypothesis in the plan.
    pub hypothesis: usize,
    /// The event times of the search, never [`Times::Auto`]. If parts were searched at different event times, the coarsest
    /// of these.
    pub times: Times,
    /// The number of independent parts, each searched by itself. The following fields cover all parts.
    #[serde(default = "one")]
    pub parts: u32,
    /// The number of different states that were kept. Between two kept states only one move at a time is possible.
    pub states: u64,
    /// How often a search by zones reached a state together with times that the cell cannot reach (D189, D209). If this
    /// is not 0, a statement may count as reached that cannot be reached.
    #[serde(default)]
    pub inexact: u64,
    /// Moves made.
    pub moves: u64,
    /// The largest number of choices on a shortest path to a state.
    pub depth: u64,
    /// Every path of at most this many choices has been covered. An unfinished search by zones has 0: it does not explore the shortest
    /// paths first.
    pub whole_depth: u64,
    /// Ticks from the start to the latest finding.
    pub ticks: u64,
    /// Whether everything within the bounds was covered.
    pub complete: bool,
    /// Whether the search left out the moves after some finding.
    pub pruned: bool,
    /// The budget that ended the search, if one did.
    pub ended_by: Option<String>,
    /// The states that the search had found but not expanded when the budget ended it.
    #[serde(default)]
    pub unfinished: Option<Unfinished>,
    /// An earlier search of the same phase at finer times, which a budget ended.
    #[serde(default)]
    pub finer: Option<Box<Coverage>>,
    /// The number of bytes of the longest packed state.
    pub longest_state: u64,
    /// The duration of the search in seconds.
    pub seconds: f64,
}

const fn one() -> u32 {
    1
}

/// The states that were found and not expanded because a budget ended the search, and what makes the search large.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unfinished {
    /// The number of states that were not expanded.
    pub open: u64,
    /// The number of states that the following fields describe: a sample of all states.
    pub sampled: u64,
    /// How many states of the sample differ in something other than times.
    pub apart_from_times: u64,
    /// The variables of tasks that have the most values in the sample, the one with the most values first.
    pub variables: Vec<ManyValues>,
}

/// A variable that has many values in the sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ManyValues {
    /// The task of the variable.
    pub task: TaskId,
    /// The variable's name in the task.
    pub name: String,
    /// The number of different values of the variable.
    pub values: u64,
}

/// Why a cell cannot be checked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// The task that cannot be checked; if the whole cell cannot be checked, the first task.
    pub task: TaskId,
    /// The operation in the task's program that prevents the check.
    pub at: Address,
    /// The reason in one line.
    pub why: String,
}

/// The result of checking a cell.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Verdicts {
    /// Why the cell was not checked; `None` if it was checked.
    pub refused: Option<Refused>,
    /// The findings, in the order of [`Kind`].
    pub findings: Vec<Finding>,
    /// Findings that may be intended ([`Kind::is_warning`]). Only a complete search looks for standstills: it reports at most one
    /// for each phase and independent part.
    #[serde(default)]
    pub warnings: Vec<Finding>,
    /// What each phase of the check has covered: the search without faults, and the search of each fault hypothesis.
    pub phases: Vec<Coverage>,
    /// Terms of checks that never changed in any state: the check's position, and the term with its value, such as
    /// `r2.active = false`.
    pub still: Vec<(usize, String)>,
    /// For each task, the number of its statements that were reached, and of all its statements.
    pub statements: Vec<(u32, u32)>,
    /// Unreached statements that may need a fault, such as those of branches, timers and take-overs: task and operation.
    pub not_exercised: Vec<(TaskId, Address)>,
    /// The values that were tried in messages from tasks outside the cell; empty if no such task sends values.
    pub outside: Tried,
    /// Unreached statements to which untried values may lead, in messages from outside the cell or as results of actions:
    /// task and operation.
    pub not_tried: Vec<(TaskId, Address)>,
    /// Unreached statements about which nothing is proved, because a budget ended a search, or a finding ended a path to them:
    /// task and operation.
    pub not_seen: Vec<(TaskId, Address)>,
}

impl Verdicts {
    /// Whether every phase covered everything at its event times.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.refused.is_none() && self.phases.iter().all(|phase| phase.complete)
    }

    /// The findings of one kind.
    pub fn of(&self, kind: Kind) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |finding| finding.kind == kind)
    }
}

/// A task after a step of a path.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// Whether the task's node runs.
    pub up: bool,
    /// The operation in which the task waits.
    pub at: Address,
    /// What the task does, in words.
    pub does: String,
    /// The task's variables, in the program's order.
    pub variables: Vec<i64>,
    /// The task's ports, each with the number of waiting messages.
    pub queues: Vec<(PortId, u16)>,
    /// The task's running actions: for each, its activation, and its least and most remaining ticks.
    pub acts: Vec<(u8, u32, u32)>,
}

/// A step of a path.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Step {
    /// Ticks since the start of the path.
    pub tick: u64,
    /// The move that was made in the step.
    pub step: CellMove,
    /// What the move shows in a chart.
    pub notes: Vec<Note>,
    /// The tasks after the step, by position.
    pub tasks: Vec<TaskView>,
}
