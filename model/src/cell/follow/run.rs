//! A recorded run, and the result of following it with [`follow_run`](super::follow_run).

use imrs_protocol::TaskId;
use imrs_protocol::script::Address;

pub use imrs_wire::recording::{Happened, Happening, Turn};

/// A recorded run: what all tasks did.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Microseconds in one tick of the model.
    pub tick: u64,
    /// For each task its events, in order.
    pub tasks: Vec<Vec<Happening>>,
    /// For each node, whether its recording is complete. A node that was killed may have done more than is recorded.
    pub whole: Vec<bool>,
}

/// What the model found when it followed a recorded run.
#[derive(Clone, Debug, Default)]
pub struct Followed {
    /// Moves that the model made.
    pub moves: u64,
    /// Recorded inputs that the model could take as the run did.
    pub inputs: u64,
    /// Script steps in which the model and the run agree.
    pub turns: u64,
    /// Packets that never arrived, by directed link: from, to, how many.
    pub lost: Vec<(usize, usize, u64)>,
    /// The most ticks by which a node of the run acted later than it would have in the model.
    pub behind: u64,
    /// The most ticks by which a node of the run acted earlier than it would have in the model.
    pub ahead: u64,
    /// Every case in which a node acted more than a tick late.
    pub late: Vec<Late>,
    /// Guessed moves of killed nodes, which no recording has.
    pub guessed: u64,
    /// How many recorded times were not rounded down to their tick, but otherwise.
    pub rounded: u64,
    /// Action results that the checker does not try.
    pub other_values: u64,
    /// The first event that the model cannot explain.
    pub unexplained: Option<Unexplained>,
    /// Whether a rounding that was not tried might explain that event: shortly before it a node acted too late, or two inputs
    /// came too close together.
    pub unsure: bool,
    /// The budget that ended the search for roundings, if one did.
    pub ended_by: Option<String>,
    /// The microsecond up to which the run was followed.
    pub until: u64,
}

/// An instance of a node that acted late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    /// The time, in microseconds of the run's clock.
    pub at: u64,
    /// The task.
    pub task: TaskId,
    /// The operation at which the task was.
    pub address: Address,
    /// Ticks by which it was late.
    pub ticks: u64,
}

/// An event of the run that the model cannot explain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unexplained {
    /// The time, in microseconds of the run's clock.
    pub at: u64,
    /// The task.
    pub task: TaskId,
    /// The operation at which the task was.
    pub address: Address,
    /// Why the model cannot explain the event, in the cell's words.
    pub why: String,
    /// Whether no rounding of times would change that.
    pub however: bool,
}
