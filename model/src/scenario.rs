//! What a world is made of: a cell, what its tasks may do, which faults the network may have, what is watched.

use imrs_protocol::{CellTable, Incarnation, NodeId, NodeTable, PortId, TaskId};
use std::sync::Arc;

/// What a task may do whenever it is free. It may also wait as long as it likes, so every program that uses its port
/// this way is covered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behaviour {
    /// Reaches the waitfor, at most so many times (`None`: for ever).
    Member {
        /// The port.
        port: PortId,
        /// How many times.
        attempts: Option<u8>,
    },
    /// Sends commands or statuses, at most so many.
    Sender {
        /// The port.
        port: PortId,
        /// How many.
        sends: u8,
    },
    /// Receives from any of its ports and answers commands, each whenever it likes.
    Receiver,
}

/// What is watched. Each is one claim's question; a world answers one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// Nobody leaves a waitfor before all arrived in its round.
    FalseRelease,
    /// The k-th release of every member is the same round, and none comes before everyone's k-th arrival.
    Pairing,
    /// When nothing is on the way any more, nobody waits in a meeting that all have reached.
    Stranded,
    /// Nobody gives up a meeting that all have reached.
    GaveUpAfterAllArrived,
    /// Nobody is released from a round that another member leaves without a release.
    AllOrNone,
    /// A member can be released at all (shown by a counterexample to "never").
    Reachable,
    /// After the faults stopped, nobody starts more than so many attempts before it is released, and everybody is.
    MeetAgain {
        /// How many attempts.
        attempts: u8,
    },
    /// No message is handed over after its sender's patience ended.
    Stale,
    /// Every command ends in exactly one outcome within its time_out and one tick; no answer belongs to another one.
    Resolves,
    /// No command ends twice: the part of `Resolves` that does not ask when an answer comes.
    ResolvesOnce,
    /// Every command ends with its answer.
    Answered,
    /// No command is handed over twice.
    AtMostOnce,
    /// Every wait ends within its time_out and one tick, so much and no more happens between two ticks, and nobody is
    /// stuck.
    Waits,
}

/// How many faults a world may have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// Lost packets.
    pub loss: u8,
    /// Duplicated packets.
    pub dup: u8,
    /// Crashed nodes; each restarts whenever it likes, or never.
    pub crash: u8,
}

/// How time may be off, beside packets that take from nothing to their longest way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// By how many ticks more than its longest way any packet may be charged.
    pub overcharge: u8,
    /// How often the timer of a node may fire a tick late (at most 15).
    pub late: u8,
}

/// Which reductions are on. Each can be switched off, and then reaches the same verdict and the same shortest length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reductions {
    /// Equal parties are sorted.
    pub symmetry: bool,
    /// Packets that nobody can notice any more vanish.
    pub ignores: bool,
    /// A packet is lost only at its last tick: before, a loss cannot be observed.
    pub lose_last: bool,
    /// What commutes between two ticks happens in one order only.
    pub turns: bool,
}

impl Reductions {
    /// All of them.
    pub const ALL: Self = Self { symmetry: true, ignores: true, lose_last: true, turns: true };
    /// None of them.
    pub const NONE: Self = Self { symmetry: false, ignores: false, lose_last: false, turns: false };
}

/// A whole world to explore.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The cell's table.
    pub cell: Arc<CellTable>,
    /// What each task may do, by task.
    pub behaviours: Vec<Behaviour>,
    /// The longest time a packet is on the way, in ticks; `None`: no time passes, packets arrive in any order.
    pub delay: Option<u8>,
    /// How many faults there may be.
    pub budget: Budget,
    /// How time may be off.
    pub timing: Timing,
    /// After how many messages the numbers of messages wrap: a variant; `None`: never within a world.
    pub wrap: Option<u8>,
    /// What is watched.
    pub watch: Watch,
    /// Whether every task acts at once when it can, before time passes.
    pub hurry: bool,
    /// For each node, how far its clock is ahead.
    pub clocks: Vec<u64>,
    /// Which reductions are on.
    pub reductions: Reductions,
}

impl Scenario {
    /// The table as `node` sees it.
    #[must_use]
    pub fn table(&self, node: NodeId) -> NodeTable {
        NodeTable::new(Arc::clone(&self.cell), node)
    }

    /// How many tasks there are.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.behaviours.len()
    }

    /// The name of a task.
    #[must_use]
    pub fn name(&self, task: TaskId) -> &str {
        self.cell.cell().tasks.get(task.index()).map_or("?", |t| &t.name)
    }

    /// Whether all tasks do the same on one waitfor port: then they are interchangeable.
    #[must_use]
    pub fn is_meeting(&self) -> bool {
        self.behaviours.iter().all(|b| matches!(b, Behaviour::Member { .. })) && self.cell.ports().len() == 1
    }

    /// Whether states that differ only in who is who count as one.
    #[must_use]
    pub fn members_alike(&self) -> bool {
        self.reductions.symmetry && self.is_meeting()
    }

    /// Whether nodes can have more than one life.
    #[must_use]
    pub const fn lives(&self) -> bool {
        self.budget.crash > 0
    }

    /// The first life of every node.
    pub const FIRST_LIFE: Incarnation = Incarnation(0);
}
