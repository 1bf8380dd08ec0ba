//! What nodes did in a recorded run, for [`follow_run`](super::follow_run).

use imrs_protocol::TaskId;
use imrs_protocol::script::Address;

pub use imrs_wire::recording::{Happened, Happening, Turn};

/// What all tasks of a run did.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Microseconds in one tick of the model.
    pub tick: u64,
    /// For each task, what happened there, in order.
    pub tasks: Vec<Vec<Happening>>,
    /// For each node, whether its recording ends by itself: a node that was killed may have done more than is recorded.
    pub whole: Vec<bool>,
}

/// What following a run comes to.
#[derive(Clone, Debug, Default)]
pub struct Followed {
    /// Moves of the model.
    pub moves: u64,
    /// Inputs of tasks that were followed.
    pub inputs: u64,
    /// Turns of scripts that the model took as the run did.
    pub turns: u64,
    /// Packets that never arrived, by directed link: from, to, how many.
    pub lost: Vec<(usize, usize, u64)>,
    /// By how many ticks, at most, a node of the run acted later than it was time in the model, and earlier.
    pub behind: u64,
    /// See `behind`.
    pub ahead: u64,
    /// Every time that a node acted later than a tick after it was time.
    pub late: Vec<Late>,
    /// Moves of killed nodes that no recording has.
    pub guessed: u64,
    /// How often a time was not rounded down to its tick, but up or farther down.
    pub rounded: u64,
    /// Results of actions that the checker does not try.
    pub other_values: u64,
    /// The first thing that the model cannot do.
    pub unexplained: Option<Unexplained>,
    /// Whether it might, with times rounded otherwise: shortly before, a node acted so late, or two things came so close to each other,
    /// that not all ways were tried.
    pub unsure: bool,
    /// Which budget ended it.
    pub ended_by: Option<String>,
    /// The microsecond up to which the run was followed.
    pub until: u64,
}

/// A node that noticed late that it was time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    /// When: microseconds of the run's clock.
    pub at: u64,
    /// Where.
    pub task: TaskId,
    /// The operation that the task stood at.
    pub address: Address,
    /// By how many ticks.
    pub ticks: u64,
}

/// Something that a run did and the model cannot do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unexplained {
    /// When: microseconds of the run's clock.
    pub at: u64,
    /// Where.
    pub task: TaskId,
    /// The operation that the task stood at.
    pub address: Address,
    /// What is wrong, in the cell's words.
    pub why: String,
    /// Whether no rounding of times would change that.
    pub however: bool,
}
