//! Records the inputs of a node's communication tasks, and checks in a replay that the state machines give the same
//! outputs again.
//!
//! A communication task is a pure function of its inputs and the times between them. Its log is written under its
//! lock. So the log has the order in which the task took its inputs, and no order among tasks is needed. Each input
//! is recorded with a digest of all outputs so far: a replay that reaches the same digests made the same outputs, bit
//! for bit.

mod digest;
mod file;
mod logged;
mod packed;
mod recording;
mod replay;
mod script;
mod verdict;

pub use digest::OutputDigest;
pub use file::{About, FileRecorder};
pub use imrs_wire::recording::{Happened, Happening, RecordingReader, ScriptStep, Turn};
pub use recording::{ReplayError, Replays, replay_recording, replay_scripts};
pub use replay::{KeyframeError, Recorded, Replay, replay};
pub use verdict::{Divergence, InvariantBroken, Miscount, ScriptDivergence, Verdict};

pub(crate) use logged::Logged;
pub(crate) use script::Did;

use imrs_protocol::script::Program;
use imrs_protocol::{
    CommTask, Input, NodeTable, Observation, Outbox, Packet, Signal, TaskId, Ticks, TimeId, invariants,
};
use std::sync::Arc;

/// One input of a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The time since the previous step, in microseconds.
    pub elapsed: Ticks,
    /// The input of the step.
    pub input: Input,
}

/// Receives the inputs of a node's communication tasks, and writes those of each task into a log of its own.
pub trait Recorder: Send + Sync {
    /// The log for the steps of `task`, from the start of the node on. `None` if this task's steps are not recorded.
    /// This is called once for each task, before the first step.
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>>;
}

/// Receives the inputs of one communication task. It is called under the task's lock, which the node's messages need.
/// So it must only store the step, and never write to a disk or wait.
pub trait Log: Send {
    /// Records a step that the task has taken, with the digest of all its outputs, those of this step included. Returns
    /// whether the log wants the task's state before the next step, because steps were lost.
    fn step(&mut self, step: &Step, digest: OutputDigest) -> bool;

    /// As [`step`](Self::step), for the task's part in a fused step (D207). A task may have two parts in one fused
    /// step. If the log wants the task's state after the first part, it gets the state only after the second.
    fn part(&mut self, step: &Step, digest: OutputDigest) -> bool {
        self.step(step, digest)
    }

    /// Records a step that the task's script is about to take, with the digest of everything that the script has done
    /// before. A signal that the communication task gives the script is not recorded as such a step.
    fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        let _ = (step, done);
    }

    /// Whether the log wants the state of the task before its first step.
    fn wants_keyframe(&self) -> bool {
        false
    }

    /// Records the state of the state machine between two steps, with the digest of all its outputs. Called if the
    /// log wants the state.
    fn keyframe(&mut self, machine: &CommTask, digest: OutputDigest) {
        let _ = (machine, digest);
    }
}

/// Identifies what scripts do: the digest of their programs, by task; zero if there are no scripts. Texts of a cell
/// that differ only in comments, or in the names of their files, have the same digest.
#[must_use]
pub fn statements<'p>(programs: impl IntoIterator<Item = (TaskId, &'p Program)>) -> u32 {
    let mut digest = OutputDigest::START;
    programs.into_iter().for_each(|program| digest.add(&program));
    let OutputDigest(whole) = digest;
    let folded = u32::try_from((whole >> 32) ^ (whole & u64::from(u32::MAX))).unwrap_or(u32::MAX);
    if digest == OutputDigest::START { 0 } else { folded.max(1) }
}

/// An outbox that digests each output and passes it on.
pub(crate) struct Digesting<'a, O> {
    pub digest: Option<&'a mut OutputDigest>,
    pub out: &'a mut O,
}

impl<O> Digesting<'_, O> {
    fn note(&mut self, output: impl FnOnce(&mut OutputDigest)) {
        if let Some(digest) = &mut self.digest {
            output(digest);
        }
    }
}

impl<O: Outbox> Outbox for Digesting<'_, O> {
    fn transmit(&mut self, packet: Packet) {
        self.note(|digest| digest.transmitted(&packet));
        self.out.transmit(packet);
    }

    fn signal(&mut self, signal: Signal) {
        self.note(|digest| digest.signalled(signal));
        self.out.signal(signal);
    }

    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.note(|digest| digest.armed(id, length));
        self.out.arm(id, turn, length);
    }

    fn disarm(&mut self, id: TimeId) {
        self.note(|digest| digest.disarmed(id));
        self.out.disarm(id);
    }

    fn observe(&mut self, observation: Observation) {
        self.out.observe(observation);
    }
}

impl Step {
    /// Whether the step brings anything besides time.
    pub(crate) const fn has_input(&self) -> bool {
        !matches!(self.input, Input::Time)
    }
}

/// Runs one step as the runtime does: first the deadlines that have passed, then the input. Checks the state machine
/// after each of the two.
fn run_checked(
    (machine, table): (&mut CommTask, &NodeTable),
    step: Step,
    out: &mut impl Outbox,
) -> Result<(), invariants::Violation> {
    let now = machine.now() + step.elapsed;
    let mut take = |input| {
        machine.handle(table, now, input, out);
        invariants::check(machine, table)
    };
    let sound = if step.elapsed.is_zero() || !step.has_input() { Ok(()) } else { take(&Input::Time) };
    sound.and(take(&step.input))
}
