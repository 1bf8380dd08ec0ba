//! Recording what goes into the communication tasks of a node, and showing that the machine does the same again (D62).
//!
//! A communication task is a pure function of its inputs and the time between them. Its log is written under its lock,
//! so it is in the order in which things happened to it, and needs no global order. Next to every input stands a digest
//! of all outputs so far: a replay that reaches the same digests made bit-equal outputs.

mod digest;
mod file;
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

pub(crate) use script::Did;

use imrs_protocol::script::Program;
use imrs_protocol::{CommTask, Input, Observation, Outbox, Packet, Signal, TaskId, Ticks, TimeId};
use std::sync::Arc;

/// One input of a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// How long after the previous step it came, in microseconds.
    pub elapsed: Ticks,
    /// What came.
    pub input: Input,
}

/// Takes the inputs of a node's communication tasks, each into a log of its own.
pub trait Recorder: Send + Sync {
    /// Where the steps of `task` go from the beginning of its life on, which is that of the node. `None` where they are not
    /// recorded. Asked once for each task, before anything happens.
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>>;
}

/// Takes the inputs of one communication task. It is called under a lock that the node's messages wait for: it must put the
/// step down and return, never write to a disk or wait.
pub trait Log: Send {
    /// What the task has taken, and the digest of everything that it has put out, this step included. Returns whether its
    /// state is wanted before the next step, because steps of it were lost.
    fn step(&mut self, step: &Step, digest: OutputDigest) -> bool;

    /// What the script of the task is about to take, besides the signals of its communication task, and the digest of
    /// everything that it has done before.
    fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        let _ = (step, done);
    }

    /// Whether the state of the task is wanted before its first step.
    fn wants_keyframe(&self) -> bool {
        false
    }

    /// The state of the machine between two steps, and the digest of everything that it has put out, where it was wanted.
    fn keyframe(&mut self, machine: &CommTask, digest: OutputDigest) {
        let _ = (machine, digest);
    }
}

/// Names what the scripts of a node do: the digest of their programs, by task; zero where there are none. Two texts of a
/// cell that differ in comments, or in names of their files, have the same one.
#[must_use]
pub fn statements<'p>(programs: impl IntoIterator<Item = (TaskId, &'p Program)>) -> u32 {
    let mut digest = OutputDigest::START;
    programs.into_iter().for_each(|program| digest.add(&program));
    let OutputDigest(whole) = digest;
    let folded = u32::try_from((whole >> 32) ^ (whole & u64::from(u32::MAX))).unwrap_or(u32::MAX);
    if digest == OutputDigest::START { 0 } else { folded.max(1) }
}

/// Digests on the way to another outbox.
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
    /// Whether anything comes besides time.
    pub(crate) const fn has_input(&self) -> bool {
        !matches!(self.input, Input::Time)
    }
}
