//! Replaying the recording of a node.

use super::replay::{KeyframeError, Recorded, Replay};
use super::{OutputDigest, Step, statements};
use crate::script::Watch;
use imrs_protocol::script::Program;
use imrs_protocol::{NodeId, NodeTable, TaskId};
use imrs_wire::recording::{Header, ReadError, Record, RecordingReader, ScriptStep, Stream};
use std::io::Read;
use std::sync::Arc;

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The recording is damaged.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The recording was made with a cell of other declarations.
    #[error("the recording is of a cell with digest {recorded:08x}, not {given:08x}")]
    OtherCell {
        /// The digest of the cell in the recording.
        recorded: u32,
        /// The digest of the cell whose table was given for the replay.
        given: u32,
    },
    /// The recording was made with the same declarations and other statements.
    #[error("the recording is of statements with digest {recorded:08x}, not {given:08x}")]
    OtherStatements {
        /// The digest of the statements in the recording.
        recorded: u32,
        /// The digest of the statements of the given scripts.
        given: u32,
    },
    /// The recording was made by another node, or its header does not name the node that made it.
    #[error("the recording holds no inputs of node {0}")]
    OtherNode(NodeId),
    /// The recording contains records of a task of another node.
    #[error("the recording holds records of {0}, which runs on another node")]
    ForeignTask(TaskId),
    /// The recording names a node, task or port that the cell does not have.
    #[error("the recording of {0} names something that is not in its cell")]
    Unknown(TaskId),
    /// The recording lasts longer than a century, or begins more than a century after the start of its state machine.
    #[error("the recording says of {0} that more than a century passed: its times are damaged")]
    NoTime(TaskId),
    /// A keyframe of the recording cannot be used.
    #[error(transparent)]
    Keyframe(#[from] KeyframeError),
}

/// The longest recording: a century, in microseconds. No node runs longer, and times of that length can still be added.
const LONGEST: u64 = 100 * 366 * 24 * 3_600 * 1_000_000;

/// Replays the recording of a node, as far as the reader has whole records: one [`Replay`] for each task of the node,
/// ascending. Afterwards [`RecordingReader::ending`] says whether the recording has a regular end. A verdict holds for
/// the records that were read.
///
/// # Errors
/// [`ReplayError`].
pub fn replay_recording<'t, R: Read>(
    reader: &mut RecordingReader<R>,
    table: &'t NodeTable,
) -> Result<Vec<Replay<'t>>, ReplayError> {
    replay_scripts(reader, table, |_| None, None)
}

/// As [`replay_recording`], and also runs those scripts of the tasks that `script` returns. If there is a `watch`, it
/// is called as [`Replay::watched`] describes, and the replays also keep in memory everything that happened.
///
/// # Errors
/// [`ReplayError`].
pub fn replay_scripts<'t, 'p, R: Read>(
    reader: &mut RecordingReader<R>,
    table: &'t NodeTable,
    script: impl Fn(TaskId) -> Option<&'p Arc<Program>>,
    watch: Option<&Arc<dyn Watch>>,
) -> Result<Vec<Replay<'t>>, ReplayError> {
    let mut replays = Replays::begin(reader.header(), table, script, watch)?;
    while replays.go_on(reader, usize::MAX)? > 0 {}
    Ok(replays.0)
}

/// The replays of a node's tasks, as far as their recording has been read. To follow a recording that is still being
/// written, call [`go_on`](Self::go_on) with the same reader from time to time.
#[derive(Debug)]
pub struct Replays<'t>(Vec<Replay<'t>>);

impl<'t> Replays<'t> {
    /// Replays from the beginning of the recording with this header. The other arguments are as for [`replay_scripts`].
    ///
    /// # Errors
    /// [`ReplayError`] if the recording is not of this node with these scripts.
    pub fn begin<'p>(
        header: &Header,
        table: &'t NodeTable,
        script: impl Fn(TaskId) -> Option<&'p Arc<Program>>,
        watch: Option<&Arc<dyn Watch>>,
    ) -> Result<Self, ReplayError> {
        if header.digest != table.digest() {
            return Err(ReplayError::OtherCell { recorded: header.digest, given: table.digest() });
        }
        if header.node != Some(table.node) {
            return Err(ReplayError::OtherNode(table.node));
        }
        let programs = || table.tasks_on(table.node).filter_map(|task| Some((task, &**script(task)?)));
        let (recorded, given) = (header.statements, statements(programs()));
        if recorded != 0 && given != 0 && recorded != given {
            return Err(ReplayError::OtherStatements { recorded, given });
        }
        let incarnation = (header.incarnation, header.restarted);
        let replay = |task| {
            let replay = Replay::new(table, task, incarnation.0, incarnation.1);
            let Some(program) = script(task) else { return replay };
            let replay = replay.with_script(program);
            match watch {
                Some(watch) => replay.keeping().watched(watch),
                None => replay,
            }
        };
        Ok(Self(table.tasks_on(table.node).map(replay).collect()))
    }

    /// Runs the next records, at most `most`. Returns how many records it ran.
    ///
    /// # Errors
    /// [`ReplayError`]. Records after the faulty one cannot be judged.
    pub fn go_on<R: Read>(
        &mut self,
        reader: &mut RecordingReader<R>,
        most: usize,
    ) -> Result<usize, ReplayError> {
        for done in 0..most {
            let Some(record) = reader.next_record()? else { return Ok(done) };
            self.take(record)?;
        }
        Ok(most)
    }

    /// The replay of each task, ascending.
    pub fn iter(&self) -> impl Iterator<Item = &Replay<'t>> {
        self.0.iter()
    }

    fn take(&mut self, record: Record) -> Result<(), ReplayError> {
        let replays = &mut self.0;
        match record {
            Record::Input { task, elapsed, input, outputs } => {
                let (step, replay) = (Step { elapsed, input }, of(replays, task)?);
                if replay.passed().saturating_add(elapsed.0) > LONGEST {
                    return Err(ReplayError::NoTime(task));
                }
                if !replay.knows(&step.input) {
                    return Err(ReplayError::Unknown(task));
                }
                replay.step(Recorded { step, digest: OutputDigest(outputs) });
            }
            Record::Keyframe { task, state, outputs } => {
                of(replays, task)?.keyframe(&state, OutputDigest(outputs))?;
            }
            Record::Script { task, step: ScriptStep::Begin { at }, .. } if at > LONGEST => {
                return Err(ReplayError::NoTime(task));
            }
            Record::Script { task, step, done } => {
                of(replays, task)?.script(step, OutputDigest(done));
            }
            Record::Close { task, inputs, outputs } => {
                of(replays, task)?.close(inputs, OutputDigest(outputs));
            }
            Record::Gap { stream: Stream::Task(task), lost } => of(replays, task)?.gap(lost),
            Record::Gap { stream: Stream::Frames(_), .. }
            | Record::Header(_)
            | Record::Frame { .. }
            | Record::End => {}
        }
        Ok(())
    }
}

fn of<'a, 't>(replays: &'a mut [Replay<'t>], task: TaskId) -> Result<&'a mut Replay<'t>, ReplayError> {
    replays.iter_mut().find(|replay| replay.task() == task).ok_or(ReplayError::ForeignTask(task))
}
