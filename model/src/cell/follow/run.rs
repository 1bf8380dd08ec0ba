//! A recorded run, and the result of following it with [`follow_run`](super::follow_run).

use imrs_protocol::TaskId;
use imrs_protocol::script::Address;

pub use imrs_wire::recording::{Happened, Happening, Turn};

/// A recorded run: everything that all tasks did.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// The length of one tick of the model, in microseconds.
    pub tick: u64,
    /// For each task, its events in order.
    pub tasks: Vec<Vec<Happening>>,
    /// For each node, whether its recording is complete. A node that was killed may have done more than is recorded.
    pub whole: Vec<bool>,
}

/// What the model found when it followed a recorded run.
#[derive(Clone, Debug, Default)]
pub struct Followed {
    /// The number of moves that the model made.
    pub moves: u64,
    /// The number of recorded inputs that the model could take as the run did.
    pub inputs: u64,
    /// The number of script steps in which the model and the run agree.
    pub turns: u64,
    /// The packets that never arrived, for each directed link: from, to, how many.
    pub lost: Vec<(usize, usize, u64)>,
    /// The most ticks by which a node of the run acted later than it would have in the model.
    pub behind: u64,
    /// The most ticks by which a node of the run acted earlier than it would have in the model.
    pub ahead: u64,
    /// Every case in which a node acted more than a tick late.
    pub late: Vec<Late>,
    /// The number of guessed moves of killed nodes, which no recording has.
    pub guessed: u64,
    /// How many recorded times were not rounded down to their tick, but otherwise.
    pub rounded: u64,
    /// The number of action results in the run that the checker does not try.
    pub other_values: u64,
    /// The first event that the model cannot explain.
    pub unexplained: Option<Unexplained>,
    /// Whether a rounding that was not tried might explain the unexplained event: shortly before the event a node acted too
    /// late, or two inputs came too close together.
    pub unsure: bool,
    /// The budget that ended the search for roundings, if one did.
    pub ended_by: Option<String>,
    /// The microsecond up to which the run was followed.
    pub until: u64,
}

/// An instance of a node that acted late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    /// When the node acted, in microseconds of the run's clock.
    pub at: u64,
    /// The task that acted late.
    pub task: TaskId,
    /// The operation at which the task was.
    pub address: Address,
    /// By how many ticks the task was late.
    pub ticks: u64,
}

/// An event of the run that the model cannot explain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unexplained {
    /// When the event happened, in microseconds of the run's clock.
    pub at: u64,
    /// The task of the event.
    pub task: TaskId,
    /// The operation at which the task was.
    pub address: Address,
    /// Why the model cannot explain the event, in the cell's words.
    pub why: String,
    /// Whether the model cannot explain the event however times are rounded.
    pub however: bool,
}
