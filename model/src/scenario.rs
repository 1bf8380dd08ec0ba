//! Scenarios to explore: a cell, what its tasks may do, fault budgets, reductions, and the property that is checked.

use imrs_protocol::{CellTable, NodeId, NodeTable, PortId, TaskId};
use std::sync::Arc;

/// What a task may do whenever it is idle. The task may also stay idle for any time, so the search covers every program that
/// uses the port in this way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behaviour {
    /// The task reaches the waitfor of a port.
    Member {
        /// The port of the rendezvous.
        port: PortId,
        /// How many times the task reaches the waitfor at most; `None` stands for any number.
        attempts: Option<u8>,
    },
    /// The task sends commands or statuses on a port.
    Sender {
        /// The port through which the task sends.
        port: PortId,
        /// How many messages the task sends at most.
        sends: u8,
    },
    /// The task receives from any of its ports and answers commands, each at any time.
    Receiver,
}

/// The property that is checked. Each property belongs to one claim, and a scenario checks one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// No member is released from a waitfor before all have arrived in its round.
    FalseRelease,
    /// The k-th release of every member is the same round, and no k-th release comes before the k-th arrival of every
    /// member.
    Pairing,
    /// When no packet is in flight, no member waits in a meeting that all members have reached.
    Stranded,
    /// No member gives up a meeting that all members have reached.
    GaveUpAfterAllArrived,
    /// No member is released from a round that another member leaves without a release.
    AllOrNone,
    /// A member can be released at all (shown by a counterexample to "never").
    Reachable,
    /// After the faults end, every member is released within this many attempts.
    MeetAgain {
        /// The number of attempts.
        attempts: u8,
    },
    /// No message is handed over after its sender's time_out.
    Stale,
    /// Every command ends with one outcome within its time_out and one tick, and never with the answer to another command.
    Resolves,
    /// As `Resolves`, but without a time limit: no command ends twice, or with the answer to another command.
    ResolvesOnce,
    /// Every command ends with its answer.
    Answered,
    /// No command is handed over twice.
    AtMostOnce,
    /// Every wait ends within its time_out and one tick, the number of steps between two ticks is bounded, and no
    /// task is stuck.
    Waits,
}

/// How many faults a world may have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// How many packets may be lost.
    pub loss: u8,
    /// How many packets may be duplicated.
    pub dup: u8,
    /// How many nodes may crash; a crashed node restarts at any time, or never.
    pub crash: u8,
}

/// Deviations of time that a scenario allows, beside link delays, which take any time up to the link's bound.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// How many ticks above the link's bound a packet may be charged.
    pub overcharge: u8,
    /// How often the timer of a node may fire a tick late (at most 15).
    pub late: u8,
}

/// Which reductions of the state space are on. With or without each of them the verdict is the same, and so is the length of
/// the shortest counterexample (except for [`Watch::MeetAgain`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reductions {
    /// Symmetry: members with equal properties are sorted, so that states which differ only in the order of members count
    /// as one.
    pub symmetry: bool,
    /// Packets that can never have an effect are dropped.
    pub ignores: bool,
    /// A packet is lost only at the last tick at which it could arrive, because an earlier loss cannot be observed.
    pub lose_last: bool,
    /// Partial order: commuting steps between two ticks are explored in one interleaving only.
    pub turns: bool,
}

impl Reductions {
    /// All reductions are on.
    pub const ALL: Self = Self { symmetry: true, ignores: true, lose_last: true, turns: true };
    /// No reduction is on.
    pub const NONE: Self = Self { symmetry: false, ignores: false, lose_last: false, turns: false };
}

/// Everything that a search needs: a cell, its tasks' behaviour, fault budgets, reductions and a property.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The cell's table.
    pub cell: Arc<CellTable>,
    /// What each task may do, by task.
    pub behaviours: Vec<Behaviour>,
    /// The longest link delay, in ticks; `None`: no time passes, and packets arrive in any order.
    pub delay: Option<u8>,
    /// The fault budgets.
    pub budget: Budget,
    /// How much later than due timers may end, and how much less than its true delay a link may charge.
    pub timing: Timing,
    /// For a variant of the rules: after how many messages sequence numbers wrap; `None`: they do not wrap.
    pub wrap: Option<u8>,
    /// The property that is checked.
    pub watch: Watch,
    /// Whether every task is eager: it acts as soon as it can, before time passes.
    pub hurry: bool,
    /// For each node, how many ticks its clock is ahead.
    pub clocks: Vec<u64>,
    /// Which reductions are on.
    pub reductions: Reductions,
}

impl Scenario {
    /// The table of the cell as `node` sees it.
    #[must_use]
    pub fn table(&self, node: NodeId) -> NodeTable {
        NodeTable::new(Arc::clone(&self.cell), node)
    }

    /// The number of tasks.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.behaviours.len()
    }

    /// The name of a task.
    #[must_use]
    pub fn name(&self, task: TaskId) -> &str {
        self.cell.cell().tasks.get(task.index()).map_or("?", |t| &t.name)
    }

    /// Whether all tasks are members of one waitfor, on the only port. Then the tasks are interchangeable.
    #[must_use]
    pub fn is_meeting(&self) -> bool {
        self.behaviours.iter().all(|b| matches!(b, Behaviour::Member { .. })) && self.cell.ports().len() == 1
    }

    /// Whether states that are equal up to renaming of the members count as one.
    #[must_use]
    pub fn members_alike(&self) -> bool {
        self.reductions.symmetry && self.is_meeting()
    }

    /// Whether nodes can have more than one incarnation.
    #[must_use]
    pub const fn incarnations(&self) -> bool {
        self.budget.crash > 0
    }
}
