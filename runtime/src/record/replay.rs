//! Running a machine again on what was recorded, and comparing everything it puts out.
//!
//! What was lost cannot be judged: a replay goes on from the next keyframe, and its verdict is [`Verdict::Unknown`], never
//! [`Verdict::Same`].

use super::{Digesting, OutputDigest, Step, run};
use imrs_protocol::{
    CommTask, Incarnation, NodeId, NodeTable, Outbox, Packet, Signal, TaskId, Ticks, TimeId,
};
use imrs_wire::recording::{ReadError, Record, RecordingReader, Stream};
use std::io::Read;

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
    /// Which step, counted from zero; steps that were not recorded are not counted.
    pub index: usize,
    /// The step.
    pub step: Step,
    /// The recorded digest after it.
    pub recorded: OutputDigest,
    /// The digest after it now.
    pub replayed: OutputDigest,
}

/// What a replay says of a task's recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is missing, and every output was the same.
    Same,
    /// Every output that could be judged was the same, but steps are missing.
    Unknown,
    /// The first step that put out something else.
    Differs(Divergence),
}

/// Why a replay cannot go on from a keyframe.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyframeError {
    /// The state cannot be read by this build.
    #[error("the state of {0} cannot be read: {1}")]
    Malformed(TaskId, postcard::Error),
    /// The state has more bytes than a machine.
    #[error("the state of {0} has {1} bytes too many")]
    Trailing(TaskId, usize),
    /// The state is that of another task, or of another life of the node.
    #[error("the state given for {0} is that of {1} in life {life}", life = .2.0)]
    Foreign(TaskId, TaskId, Incarnation),
    /// Nothing is missing before the keyframe, and yet it names other outputs.
    #[error("the keyframe of {0} contradicts the steps before it")]
    Contradicts(TaskId),
}

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The recording is damaged.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It was made with another cell.
    #[error("the recording is of a cell with digest {recorded:08x}, not {given:08x}")]
    OtherCell {
        /// The digest in the recording.
        recorded: u32,
        /// The digest of the table to replay with.
        given: u32,
    },
    /// It was made by another node, or by none.
    #[error("the recording holds no inputs of node {0}")]
    OtherNode(NodeId),
    /// It holds records of a task of another node.
    #[error("the recording holds records of {0}, which runs on another node")]
    ForeignTask(TaskId),
    /// A keyframe is not what it should be.
    #[error(transparent)]
    Keyframe(#[from] KeyframeError),
}

/// A communication task that is run again, step by step.
#[derive(Clone, Debug)]
pub struct Replay<'t> {
    table: &'t NodeTable,
    task: TaskId,
    incarnation: Incarnation,
    /// `None` while its state is not known.
    machine: Option<CommTask>,
    digest: OutputDigest,
    judged: usize,
    unjudged: usize,
    lost: u64,
    divergence: Option<Divergence>,
}

impl<'t> Replay<'t> {
    /// The machine of `task` at its start in this life of its node.
    #[must_use]
    pub fn new(table: &'t NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        Self {
            table,
            task,
            incarnation,
            machine: Some(CommTask::new(table, task, incarnation, restarted)),
            digest: OutputDigest::START,
            judged: 0,
            unjudged: 0,
            lost: 0,
            divergence: None,
        }
    }

    /// Runs the next step. After a gap, or a step that put out something else, steps are only counted until a keyframe
    /// comes.
    pub fn step(&mut self, entry: Recorded) {
        let Some(machine) = &mut self.machine else {
            self.unjudged += 1;
            return;
        };
        let mut out = Digesting { digest: Some(&mut self.digest), out: &mut Ignore };
        run(machine, self.table, entry.step, &mut out);
        if self.digest == entry.digest {
            self.judged += 1;
            return;
        }
        let (recorded, replayed) = (entry.digest, self.digest);
        let index = self.judged + self.unjudged;
        let divergence = Divergence { task: self.task, index, step: entry.step, recorded, replayed };
        self.divergence.get_or_insert(divergence);
        self.unjudged += 1;
        self.machine = None;
    }

    /// Records are missing here.
    pub fn gap(&mut self, lost: u64) {
        self.lost = self.lost.saturating_add(lost);
        self.machine = None;
    }

    /// Goes on from a recorded state.
    ///
    /// # Errors
    /// [`KeyframeError`]. The replay stays as it was.
    pub fn keyframe(&mut self, state: &[u8], digest: OutputDigest) -> Result<(), KeyframeError> {
        let (machine, rest) = postcard::take_from_bytes::<CommTask>(state)
            .map_err(|error| KeyframeError::Malformed(self.task, error))?;
        if !rest.is_empty() {
            return Err(KeyframeError::Trailing(self.task, rest.len()));
        }
        let (task, life) = (machine.task(), machine.incarnation());
        if (task, life) != (self.task, self.incarnation) {
            return Err(KeyframeError::Foreign(self.task, task, life));
        }
        if self.machine.is_some() && digest != self.digest {
            return Err(KeyframeError::Contradicts(self.task));
        }
        (self.machine, self.digest) = (Some(machine), digest);
        Ok(())
    }

    /// The task.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.task
    }

    /// How many steps put out what was recorded.
    #[must_use]
    pub const fn judged(&self) -> usize {
        self.judged
    }

    /// How many recorded steps could not be judged, because the state before them is not known, or differed.
    #[must_use]
    pub const fn unjudged(&self) -> usize {
        self.unjudged
    }

    /// How many records are missing.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// What was found so far.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        match self.divergence {
            Some(divergence) => Verdict::Differs(divergence),
            None if self.lost > 0 || self.unjudged > 0 || self.machine.is_none() => Verdict::Unknown,
            None => Verdict::Same,
        }
    }
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
    let mut replay = Replay::new(table, task, incarnation, restarted);
    for entry in recorded {
        replay.step(entry);
        if let Some(divergence) = replay.divergence {
            return Err(divergence);
        }
    }
    Ok(replay.judged)
}

/// Replays what a node recorded, as far as the reader has whole records: one [`Replay`] for each task of the node,
/// ascending. [`RecordingReader::ending`] says then whether the recording was ended; a verdict holds for what was read.
///
/// # Errors
/// [`ReplayError`].
pub fn replay_recording<'t, R: Read>(
    reader: &mut RecordingReader<R>,
    table: &'t NodeTable,
) -> Result<Vec<Replay<'t>>, ReplayError> {
    let header = reader.header();
    if header.digest != table.digest() {
        return Err(ReplayError::OtherCell { recorded: header.digest, given: table.digest() });
    }
    if header.node != Some(table.node) {
        return Err(ReplayError::OtherNode(table.node));
    }
    let life = (header.incarnation, header.restarted);
    let tasks = table.tasks_on(table.node);
    let mut replays: Vec<Replay<'t>> = tasks.map(|task| Replay::new(table, task, life.0, life.1)).collect();
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Input { task, elapsed, input, outputs } => {
                let step = Step { elapsed, input };
                of(&mut replays, task)?.step(Recorded { step, digest: OutputDigest(outputs) });
            }
            Record::Keyframe { task, state, outputs } => {
                of(&mut replays, task)?.keyframe(&state, OutputDigest(outputs))?;
            }
            Record::Gap { stream: Stream::Task(task), lost } => of(&mut replays, task)?.gap(lost),
            Record::Gap { stream: Stream::Frames(_), .. }
            | Record::Header(_)
            | Record::Frame { .. }
            | Record::End => {}
        }
    }
    Ok(replays)
}

fn of<'a, 't>(replays: &'a mut [Replay<'t>], task: TaskId) -> Result<&'a mut Replay<'t>, ReplayError> {
    replays.iter_mut().find(|replay| replay.task == task).ok_or(ReplayError::ForeignTask(task))
}

struct Ignore;

impl Outbox for Ignore {
    fn transmit(&mut self, _packet: Packet) {}
    fn signal(&mut self, _signal: Signal) {}
    fn arm(&mut self, _id: TimeId, _turn: u8, _length: Ticks) {}
    fn disarm(&mut self, _id: TimeId) {}
}
