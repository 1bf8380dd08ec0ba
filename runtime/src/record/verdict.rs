//! The results of replaying a task's recording.

use super::{OutputDigest, Step};
use imrs_protocol::TaskId;
use imrs_protocol::invariants::Violation;

/// The first step after which the state machine's outputs differ from the recorded ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {index} of {task} put out something else than recorded: {step:?}")]
pub struct Divergence {
    /// The task whose communication task was recorded.
    pub task: TaskId,
    /// The number of the step, counted from zero. Steps that were not recorded do not count.
    pub index: usize,
    /// The step whose outputs differ.
    pub step: Step,
    /// The recorded digest after the step.
    pub recorded: OutputDigest,
    /// The digest after the step in the replay.
    pub replayed: OutputDigest,
}

/// The result of replaying a task's recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The recording is complete, and each output of the replay equals the recorded one.
    Same,
    /// Every output that could be judged equals the recorded one, but steps are missing.
    Unknown,
    /// A step of the replay had other outputs than the recorded step; this is the first such step.
    Differs(Divergence),
    /// The script of the task did something else in the replay than in the recording.
    ScriptDiffers(ScriptDivergence),
    /// An invariant that must hold for every state machine did not hold for this one.
    Breaks(InvariantBroken),
    /// The last record of the task contradicts the records before it.
    Miscounts(Miscount),
}

/// An invariant of the state machine did not hold. This is a fault of the machine, never of a program or of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at step {index} of {task}: {violation}")]
pub struct InvariantBroken {
    /// The task whose communication task was recorded.
    pub task: TaskId,
    /// The number of the step, counted as in [`Divergence`].
    pub index: usize,
    /// The invariant that does not hold.
    pub violation: Violation,
}

/// The last record of a task does not fit the records before it: there are too few inputs, or too many, and no gap says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{task} took {said} inputs with outputs {said_outputs:016x}, the recording has {found} with {outputs:016x}", said_outputs = .said_outputs.0, outputs = .outputs.0)]
pub struct Miscount {
    /// The task whose inputs or outputs were counted wrongly.
    pub task: TaskId,
    /// How many inputs the task took, according to its last record.
    pub said: u64,
    /// How many inputs of the task the recording has.
    pub found: u64,
    /// The digest of the task's outputs, according to its last record.
    pub said_outputs: OutputDigest,
    /// The digest of the task's outputs in the replay.
    pub outputs: OutputDigest,
}

/// The script of a task did something else in the replay than in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("after step {index} of {task} its script did something else than recorded")]
pub struct ScriptDivergence {
    /// The task whose script differs.
    pub task: TaskId,
    /// How many steps of the communication task had been replayed before.
    pub index: usize,
}
