//! The results of replaying a task's recording.

use super::{OutputDigest, Step};
use imrs_protocol::TaskId;
use imrs_protocol::invariants::Violation;

/// The machine did something else than the recording says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {index} of {task} put out something else than recorded: {step:?}")]
pub struct Divergence {
    /// The communication task's task.
    pub task: TaskId,
    /// Which step, counted from zero; steps that were not recorded are not counted.
    pub index: usize,
    /// The step.
    pub step: Step,
    /// The recorded digest after it.
    pub recorded: OutputDigest,
    /// The digest after it now.
    pub replayed: OutputDigest,
}

/// The result of replaying a task's recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is missing, and every output was the same.
    Same,
    /// Every output that could be judged was the same, but steps are missing.
    Unknown,
    /// The first step that put out something else.
    Differs(Divergence),
    /// The script of the task did something else than recorded.
    ScriptDiffers(ScriptDivergence),
    /// An invariant that holds of every machine did not hold of this one.
    Breaks(InvariantBroken),
    /// The recording does not have what it says that it has.
    Miscounts(Miscount),
}

/// An invariant of the machine did not hold: a fault of the machine, never of a program or of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at step {index} of {task}: {violation}")]
pub struct InvariantBroken {
    /// The communication task's task.
    pub task: TaskId,
    /// Which step, counted as in [`Divergence`].
    pub index: usize,
    /// What does not hold.
    pub violation: Violation,
}

/// The last record of a task does not fit the records before it: there are too few inputs, or too many, and no gap says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{task} took {said} inputs with outputs {said_outputs:016x}, the recording has {found} with {outputs:016x}", said_outputs = .said_outputs.0, outputs = .outputs.0)]
pub struct Miscount {
    /// The task.
    pub task: TaskId,
    /// How many inputs it took, by its last record.
    pub said: u64,
    /// How many there are.
    pub found: u64,
    /// The digest of its outputs, by its last record.
    pub said_outputs: OutputDigest,
    /// The digest of the replayed outputs.
    pub outputs: OutputDigest,
}

/// The script did something else than the recording says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("after step {index} of {task} its script did something else than recorded")]
pub struct ScriptDivergence {
    /// The task.
    pub task: TaskId,
    /// How many steps of the communication task had been run.
    pub index: usize,
}
