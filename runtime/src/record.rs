//! Recording what goes into the communication tasks of a node, and showing that the machine does the same again (D62).
//!
//! A communication task is a pure function of its inputs and the time between them. Its log is written under its lock,
//! so it is in the order in which things happened to it, and needs no global order. Next to every input stands a digest
//! of all outputs so far: a replay that reaches the same digests made bit-equal outputs.

mod file;

pub use file::FileRecorder;
use imrs_protocol::{
    CommTask, Incarnation, Input, NodeTable, Observation, Outbox, Packet, Signal, TaskId, Ticks, TimeId,
};
use std::hash::{Hash, Hasher};

/// One input of a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// How long after the previous step it came, in microseconds.
    pub elapsed: Ticks,
    /// What came.
    pub input: Input,
}

/// Takes the inputs of a node's communication tasks. It is called under a lock that the node's messages wait for: it
/// must hand the step on and return, never write to a disk or wait.
pub trait Recorder: Send + Sync {
    /// What `task` is about to take. Its life, for a log that begins here, is that of the node.
    fn input(&self, task: TaskId, step: Step);
    /// The digest of everything that `task` has put out, this step included.
    fn output(&self, task: TaskId, digest: OutputDigest);
}

/// Names everything that a communication task has put out so far, in order. Equal in two runs only if every packet,
/// every signal and every request to the Timer was equal (but for collisions of 64 bits).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputDigest(pub u64);

impl OutputDigest {
    /// Of no output. FNV-1a's offset.
    pub const START: Self = Self(0xcbf2_9ce4_8422_2325);
}

/// FNV-1a with every number in little endian, so that the digest does not depend on the machine.
impl Hasher for OutputDigest {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn write_u16(&mut self, value: u16) {
        self.write(&value.to_le_bytes());
    }

    fn write_u32(&mut self, value: u32) {
        self.write(&value.to_le_bytes());
    }

    fn write_u64(&mut self, value: u64) {
        self.write(&value.to_le_bytes());
    }

    fn write_usize(&mut self, value: usize) {
        self.write_u64(value as u64);
    }

    fn write_isize(&mut self, value: isize) {
        self.write_i64(value as i64);
    }

    fn write_i64(&mut self, value: i64) {
        self.write(&value.to_le_bytes());
    }
}

/// What one output is called in the digest.
#[derive(Hash)]
enum Output {
    Transmit(Packet),
    Signal(Signal),
    Arm(TimeId, Ticks),
    Disarm(TimeId),
}

/// Digests on the way to another outbox.
pub(crate) struct Digesting<'a, O> {
    pub digest: Option<&'a mut OutputDigest>,
    pub out: &'a mut O,
}

impl<O> Digesting<'_, O> {
    fn note(&mut self, output: impl FnOnce() -> Output) {
        if let Some(digest) = &mut self.digest {
            output().hash(*digest);
        }
    }
}

impl<O: Outbox> Outbox for Digesting<'_, O> {
    fn transmit(&mut self, packet: Packet) {
        self.note(|| Output::Transmit(packet));
        self.out.transmit(packet);
    }

    fn signal(&mut self, signal: Signal) {
        self.note(|| Output::Signal(signal));
        self.out.signal(signal);
    }

    fn arm(&mut self, id: TimeId, length: Ticks) {
        self.note(|| Output::Arm(id, length));
        self.out.arm(id, length);
    }

    fn disarm(&mut self, id: TimeId) {
        self.note(|| Output::Disarm(id));
        self.out.disarm(id);
    }

    fn observe(&mut self, observation: Observation) {
        self.out.observe(observation);
    }
}

/// Runs one step: first the time passes, then the input comes. The runtime and the replay both do exactly this.
pub(crate) fn run(machine: &mut CommTask, table: &NodeTable, step: Step, out: &mut impl Outbox) {
    if !step.elapsed.is_zero() {
        machine.handle(table, Input::Advance(step.elapsed), out);
    }
    match step.input {
        Input::Advance(Ticks::ZERO) => {}
        input => machine.handle(table, input, out),
    }
}

/// A recorded step and the digest after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// The step.
    pub step: Step,
    /// What had been put out after it.
    pub digest: OutputDigest,
}

/// The machine did something else than the recording says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {index} of {task} put out something else than recorded: {step:?}")]
pub struct Divergence {
    /// The communication task's task.
    pub task: TaskId,
    /// Which step, counted from zero.
    pub index: usize,
    /// The step.
    pub step: Step,
    /// The recorded digest after it.
    pub recorded: OutputDigest,
    /// The digest after it now.
    pub replayed: OutputDigest,
}

struct Ignore;

impl Outbox for Ignore {
    fn transmit(&mut self, _packet: Packet) {}
    fn signal(&mut self, _signal: Signal) {}
    fn arm(&mut self, _id: TimeId, _length: Ticks) {}
    fn disarm(&mut self, _id: TimeId) {}
}

/// Runs the machine of `task` through its recorded inputs, from its start in the given life of its node, and compares
/// all outputs. Returns how many steps were run.
///
/// # Errors
/// The first step whose outputs differ.
pub fn replay(
    table: &NodeTable,
    task: TaskId,
    incarnation: Incarnation,
    restarted: bool,
    recorded: impl IntoIterator<Item = Recorded>,
) -> Result<usize, Divergence> {
    let mut machine = CommTask::new(table, task, incarnation, restarted);
    let mut digest = OutputDigest::START;
    let mut steps = 0;
    for (index, entry) in recorded.into_iter().enumerate() {
        let mut out = Digesting { digest: Some(&mut digest), out: &mut Ignore };
        run(&mut machine, table, entry.step, &mut out);
        if digest != entry.digest {
            let (recorded, replayed) = (entry.digest, digest);
            return Err(Divergence { task, index, step: entry.step, recorded, replayed });
        }
        steps += 1;
    }
    Ok(steps)
}
