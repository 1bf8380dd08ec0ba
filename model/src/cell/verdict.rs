//! What the check of a cell says.

use super::course::CellMove;
use super::plan::Times;
use super::values::Tried;
use crate::chart::Note;
use imrs_protocol::script::Address;
use imrs_protocol::{PortId, TaskId};
use serde::{Deserialize, Serialize};

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Kind {
    /// Tasks wait for each other for ever, and nothing can happen any more.
    Deadlock,
    /// A request ends by its time_out although nothing went wrong.
    TimeOut,
    /// A request is put off more often than aging allows, although nothing went wrong (D58).
    Starves,
    /// A member waits at a waitfor in vain although nothing went wrong.
    Stranded,
    /// A message is refused although nothing went wrong.
    Refused,
    /// A statement without a branch for it ends badly, and its task with it.
    Ends,
    /// A task aborts as it is told to, although nothing went wrong.
    Aborts,
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
    /// A check says nothing: what makes it matter never happens.
    Vacuous,
    /// Tasks go on for ever without coming further: a warning.
    Standstill,
    /// A task is left waiting when all that could help it have ended, or are down: a warning.
    WaitsForEver,
    /// The machine itself is at fault, or the state outgrew its packed form.
    Machine,
}

impl Kind {
    /// Whether it may well be meant: it fails nothing.
    #[must_use]
    pub const fn is_warning(self) -> bool {
        matches!(self, Self::Standstill | Self::WaitsForEver)
    }

    /// One or two words for a heading.
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

/// Which search found it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// Nothing goes wrong.
    FaultFree,
    /// What is declared goes wrong.
    Faults,
}

/// What a task that a finding concerns does when it is found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Concerned {
    /// Which.
    pub task: TaskId,
    /// The operation that it is at, or was at last; none where it began no statement.
    pub at: Option<Address>,
    /// What it does, in words.
    pub does: String,
}

/// Something that is wrong, and the shortest way to it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finding {
    /// What.
    pub kind: Kind,
    /// Whether it takes a fault.
    pub phase: Phase,
    /// With faults, which of the plan's hypotheses.
    pub hypothesis: usize,
    /// At which times it was found.
    pub times: Times,
    /// In which independent part of the cell it was found; none: the cell was searched as a whole.
    #[serde(default)]
    pub part: Option<usize>,
    /// Whose it is.
    pub task: Option<TaskId>,
    /// The tasks with the same statements that have the same finding at theirs.
    #[serde(default)]
    pub also: Vec<TaskId>,
    /// The operation of its program.
    pub address: Option<Address>,
    /// The check, by its position.
    pub check: Option<usize>,
    /// The work couple, by its position among the cell's.
    pub couple: Option<usize>,
    /// What the other tasks that it concerns do.
    pub others: Vec<Concerned>,
    /// One line in the cell's words.
    pub cause: String,
    /// When, in ticks from the start.
    pub at_ticks: u64,
    /// The moves that lead there: with the same plan they replay it.
    pub moves: Vec<CellMove>,
    /// The same, to be shown.
    pub steps: Vec<Step>,
    /// The same as a sequence chart of at most 78 columns: what happens again and again is drawn once.
    pub chart: String,
}

/// What a phase has looked at.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Coverage {
    /// Which.
    pub phase: Phase,
    /// With faults, which of the plan's hypotheses.
    pub hypothesis: usize,
    /// At which times: never [`Times::Auto`]. Where parts were searched at different ones, the coarsest.
    pub times: Times,
    /// How many independent parts were searched, each by itself. What follows counts all of them.
    #[serde(default = "one")]
    pub parts: u32,
    /// Different states kept; between two of them only one thing can happen.
    pub states: u64,
    /// Moves made.
    pub moves: u64,
    /// The most choices on a shortest way to a state.
    pub depth: u64,
    /// Everything that takes at most so many choices was looked at.
    pub whole_depth: u64,
    /// Ticks of the longest shortest way.
    pub ticks: u64,
    /// Whether everything within the bounds was looked at.
    pub complete: bool,
    /// Whether what follows some finding was not looked at.
    pub pruned: bool,
    /// Which budget ended it.
    pub ended_by: Option<String>,
    /// Bytes of the longest state.
    pub longest_state: u64,
    /// Seconds that it took.
    pub seconds: f64,
}

const fn one() -> u32 {
    1
}

/// Why a cell is not checked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// Whose it is.
    pub task: TaskId,
    /// The operation of its program.
    pub at: Address,
    /// One line.
    pub why: String,
}

/// What the check of a cell found.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Verdicts {
    /// Why nothing was looked at, if so.
    pub refused: Option<Refused>,
    /// What is wrong, in the order of [`Kind`].
    pub findings: Vec<Finding>,
    /// What may well be meant ([`Kind::is_warning`]). Of standstills, one for each phase, and in it for each independent
    /// part, that was searched to its end.
    #[serde(default)]
    pub warnings: Vec<Finding>,
    /// What was looked at.
    pub phases: Vec<Coverage>,
    /// What checks read that never changed in any state: the check's position, and what it was, as `r2.active = false`.
    pub still: Vec<(usize, String)>,
    /// For each task the statements reached, and how many it has.
    pub statements: Vec<(u32, u32)>,
    /// Statements of branches, timers and take-overs that these faults never called for: task and operation.
    pub not_exercised: Vec<(TaskId, Address)>,
    /// The values with which messages from tasks outside the cell were tried; empty where no such task says anything.
    pub outside: Tried,
    /// Statements never reached with these values and those tried as results of actions: other ones may lead there. Task and
    /// operation.
    pub not_tried: Vec<(TaskId, Address)>,
    /// Statements not reached where a budget ended a search, or a finding the way to them, which proves nothing: task and
    /// operation.
    pub not_seen: Vec<(TaskId, Address)>,
}

impl Verdicts {
    /// Whether every phase looked at everything at its times.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.refused.is_none() && self.phases.iter().all(|phase| phase.complete)
    }

    /// The findings of a kind.
    pub fn of(&self, kind: Kind) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |finding| finding.kind == kind)
    }
}

/// What a task does after a step.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// Whether its node runs.
    pub up: bool,
    /// The operation that it waits in.
    pub at: Address,
    /// What it does, in words.
    pub does: String,
    /// Its variables, in the program's order.
    pub variables: Vec<i64>,
    /// Its ports and how many messages wait there.
    pub queues: Vec<(PortId, u16)>,
    /// Its actions: the thread, and the least and the most ticks that each takes yet.
    pub acts: Vec<(u8, u32, u32)>,
}

/// A step of a way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Step {
    /// Ticks since the start.
    pub tick: u64,
    /// What happened.
    pub step: CellMove,
    /// What it showed.
    pub notes: Vec<Note>,
    /// The tasks after it, by task.
    pub tasks: Vec<TaskView>,
}
