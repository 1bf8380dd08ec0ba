//! Recording what goes into the communication tasks of a node, and showing that the machine does the same again (D62).
//!
//! A communication task is a pure function of its inputs and the time between them. Its log is written under its lock,
//! so it is in the order in which things happened to it, and needs no global order. Next to every input stands a digest
//! of all outputs so far: a replay that reaches the same digests made bit-equal outputs.

mod file;
mod recording;
mod replay;
mod script;
mod verdict;

pub use file::{About, FileRecorder};
pub use imrs_wire::recording::{Happened, Happening, RecordingReader, ScriptStep, Turn};
pub use recording::{ReplayError, replay_recording, replay_scripts};
pub use replay::{KeyframeError, Recorded, Replay, replay};
pub use verdict::{Divergence, InvariantBroken, Miscount, ScriptDivergence, Verdict};

pub(crate) use script::Did;

use imrs_protocol::script::Program;
use imrs_protocol::{CommTask, Input, NodeTable, Observation, Outbox, Packet, Signal, TaskId, Ticks, TimeId};
use postcard::ser_flavors::Flavor;
use serde::Serialize;

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
    /// What `task` has taken, and the digest of everything that it has put out, this step included. Its life, for a log
    /// that begins here, is that of the node. Returns whether its state is wanted before the next step, because steps
    /// of it were lost.
    fn step(&self, task: TaskId, step: Step, digest: OutputDigest) -> bool;

    /// What the script of `task` is about to take, besides the signals of its communication task, and the digest of
    /// everything that it has done before.
    fn script(&self, task: TaskId, step: ScriptStep, done: OutputDigest) {
        let _ = (task, step, done);
    }

    /// Whether the state of `task` is wanted before its first step.
    fn wants_keyframe(&self, task: TaskId) -> bool {
        let _ = task;
        false
    }

    /// The state of a machine between two steps, and the digest of everything that it has put out, where it was wanted.
    fn keyframe(&self, machine: &CommTask, digest: OutputDigest) {
        let _ = (machine, digest);
    }
}

/// Names everything that a communication task, or a script, has put out so far, in order. Equal in two runs only if every packet,
/// every signal and every request to the Timer was equal (but for collisions of 64 bits). It is taken of the outputs in
/// postcard, so it is the same in every build and on every machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputDigest(pub u64);

impl OutputDigest {
    /// Of no output.
    pub const START: Self = Self(0xcbf2_9ce4_8422_2325);

    pub(crate) fn add(&mut self, output: &impl Serialize) {
        // Nothing in an output can fail to be written down; if ever, the digest stops in both runs alike.
        if let Ok(hash) = postcard::serialize_with_flavor(output, Mixer { hash: self.0, lane: 0, filled: 0 })
        {
            self.0 = hash;
        }
    }
}

/// Mixes eight bytes at a time into a hash: each lane by xor, a multiplication and a shift, none of which loses anything. The
/// last lane, which is never full, has the number of its bytes on top.
struct Mixer {
    hash: u64,
    lane: u64,
    /// Bits.
    filled: u32,
}

impl Mixer {
    fn mix(&mut self) {
        let hash = (self.hash ^ self.lane).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        *self = Self { hash: hash ^ (hash >> 32), lane: 0, filled: 0 };
    }
}

impl Flavor for Mixer {
    type Output = u64;

    #[inline]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.lane |= u64::from(byte) << self.filled;
        self.filled += 8;
        if self.filled == u64::BITS {
            self.mix();
        }
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<u64> {
        self.lane |= u64::from(self.filled / 8) << 56;
        self.mix();
        Ok(self.hash)
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

/// What one output is called in the digest. The order of the variants, and of those in them, is part of the recordings'
/// format.
#[derive(Serialize)]
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
            digest.add(&output());
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

    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.note(|| Output::Arm(id, length));
        self.out.arm(id, turn, length);
    }

    fn disarm(&mut self, id: TimeId) {
        self.note(|| Output::Disarm(id));
        self.out.disarm(id);
    }

    fn observe(&mut self, observation: Observation) {
        self.out.observe(observation);
    }
}

impl Step {
    /// What the machine takes: first the time passes, then the input comes. The runtime and the replay both do exactly
    /// this.
    pub(crate) fn parts(self) -> impl Iterator<Item = Input> {
        let time = (!self.elapsed.is_zero()).then_some(Input::Advance(self.elapsed));
        let input = Some(self.input).filter(|input| *input != Input::Advance(Ticks::ZERO));
        time.into_iter().chain(input)
    }
}

/// Runs one step.
pub(crate) fn run(machine: &mut CommTask, table: &NodeTable, step: Step, out: &mut impl Outbox) {
    step.parts().for_each(|input| machine.handle(table, input, out));
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Contents, Outcome};

    /// Recordings of other builds are compared with these numbers: whoever changes them changes the version of
    /// recordings.
    #[test]
    fn the_digest_is_that_of_lanes_of_the_outputs_in_postcard() {
        let mut digest = OutputDigest::START;
        let answer = Outcome::Reply(Contents::new(b"yes").unwrap());
        let outputs: [(Output, &[u8]); 4] = [
            (Output::Arm(TimeId(1), Ticks(300)), &[2, 1, 0xac, 0x02]),
            (Output::Disarm(TimeId(1)), &[3, 1]),
            (
                Output::Signal(Signal::Outcome(answer)),
                &[1, 2, 0, 3, b'y', b'e', b's', 0, 0, 0, 0, 0, 0, 0, 0, 0],
            ),
            // A full lane is followed by an empty one.
            (Output::Arm(TimeId(1), Ticks(1 << 36)), &[2, 1, 0x80, 0x80, 0x80, 0x80, 0x80, 0x02]),
        ];
        let mut plain = OutputDigest::START.0;
        for (output, bytes) in outputs {
            assert_eq!(postcard::to_allocvec(&output).unwrap(), bytes);
            digest.add(&output);
            let whole = bytes.len() / 8 * 8;
            let lanes = bytes[..whole].chunks(8).map(|lane| u64::from_le_bytes(lane.try_into().unwrap()));
            let mut last = [0; 8];
            last[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            last[7] = u8::try_from(bytes.len() - whole).unwrap();
            for lane in lanes.chain([u64::from_le_bytes(last)]) {
                plain = (plain ^ lane).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                plain ^= plain >> 32;
            }
        }
        assert_eq!(digest, OutputDigest(plain));
        assert_eq!(digest, OutputDigest(0x92a2_0745_ab21_ca80));
    }
}
