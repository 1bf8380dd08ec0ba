//! Replaying the recording of a node.

use super::replay::{KeyframeError, Recorded, Replay};
use super::{OutputDigest, Step, statements};
use crate::script::Watch;
use imrs_protocol::script::Program;
use imrs_protocol::{NodeId, NodeTable, TaskId};
use imrs_wire::recording::{ReadError, Record, RecordingReader, Stream};
use std::io::Read;
use std::sync::Arc;

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
    /// It was made with the same declarations and other statements.
    #[error("the recording is of statements with digest {recorded:08x}, not {given:08x}")]
    OtherStatements {
        /// The digest in the recording.
        recorded: u32,
        /// The digest of the given scripts.
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

/// Replays what a node recorded, as far as the reader has whole records: one [`Replay`] for each task of the node,
/// ascending. [`RecordingReader::ending`] says then whether the recording was ended; a verdict holds for what was read.
///
/// # Errors
/// [`ReplayError`].
pub fn replay_recording<'t, R: Read>(
    reader: &mut RecordingReader<R>,
    table: &'t NodeTable,
) -> Result<Vec<Replay<'t>>, ReplayError> {
    replay_scripts(reader, table, |_| None, None)
}

/// The same, with the scripts of those tasks that `script` knows. With somebody who watches, who is told as
/// [`Replay::watched`] says, what happened is kept, too: that takes memory for all of it.
///
/// # Errors
/// [`ReplayError`].
pub fn replay_scripts<'t, 'p, R: Read>(
    reader: &mut RecordingReader<R>,
    table: &'t NodeTable,
    script: impl Fn(TaskId) -> Option<&'p Arc<Program>>,
    watch: Option<&Arc<dyn Watch>>,
) -> Result<Vec<Replay<'t>>, ReplayError> {
    let header = reader.header();
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
    let life = (header.incarnation, header.restarted);
    let replay = |task| {
        let replay = Replay::new(table, task, life.0, life.1);
        let Some(program) = script(task) else { return replay };
        let replay = replay.with_script(program);
        match watch {
            Some(watch) => replay.keeping().watched(watch),
            None => replay,
        }
    };
    let mut replays: Vec<Replay<'t>> = table.tasks_on(table.node).map(replay).collect();
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Input { task, elapsed, input, outputs } => {
                let step = Step { elapsed, input };
                of(&mut replays, task)?.step(Recorded { step, digest: OutputDigest(outputs) });
            }
            Record::Keyframe { task, state, outputs } => {
                of(&mut replays, task)?.keyframe(&state, OutputDigest(outputs))?;
            }
            Record::Script { task, step, done } => {
                of(&mut replays, task)?.script(step, OutputDigest(done));
            }
            Record::Close { task, inputs, outputs } => {
                of(&mut replays, task)?.close(inputs, OutputDigest(outputs));
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
    replays.iter_mut().find(|replay| replay.task() == task).ok_or(ReplayError::ForeignTask(task))
}
