//! `imrs replay`: runs the state machine again on what a node recorded, and compares every output.

use crate::args::{Format, ReplayArgs};
use crate::cells;
use crate::exit::{Exit, Failure};
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count};
use imrs_protocol::{CellTable, NodeId, NodeTable, TaskId};
use imrs_runtime::record::{OutputDigest, Recorded, Step, replay};
use imrs_wire::recording::{Ending, ReadError, Record, RecordingReader, Stream};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::PathBuf;
use std::sync::Arc;

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be opened.
    #[error("{path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is not a recording, or is damaged.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: ReadError,
    },
    /// The recording is of a cell that this program does not have.
    #[error("{path} was made with another cell: `{cell}`, digest {digest:08x}")]
    OtherCell {
        /// The file.
        path: PathBuf,
        /// The name of the cell.
        cell: String,
        /// The digest of its table.
        digest: u32,
    },
    /// The recording has no node's inputs.
    #[error("{0} holds no inputs of a node")]
    NoInputs(PathBuf),
}

/// What a replay found.
#[derive(Debug, Serialize)]
struct Replayed {
    version: u32,
    cell: String,
    node: String,
    build: String,
    insecure: bool,
    /// Whether the file has its end.
    whole: bool,
    tasks: Vec<Task>,
}

/// What the replay of one task found.
#[derive(Debug, Serialize)]
struct Task {
    name: String,
    /// Steps that were run again.
    steps: usize,
    /// Inputs that were not recorded: what comes after them cannot be judged.
    lost: u64,
    /// The first step that put out something else, if any did.
    divergence: Option<String>,
}

/// Replays a recording.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    let replayed = read(&args.file)?;
    let diverged = replayed.tasks.iter().any(|task| task.divergence.is_some());
    match args.format {
        Format::Json => out.json(&replayed)?,
        Format::Text => show(&replayed, out)?,
    }
    Ok(if diverged { Exit::Finding } else { Exit::Well })
}

/// The inputs of one task up to the first that is missing.
#[derive(Default)]
struct Log {
    steps: Vec<Recorded>,
    lost: u64,
}

fn read(path: &PathBuf) -> Result<Replayed, ReplayError> {
    let file = File::open(path).map_err(|source| ReplayError::Open { path: path.clone(), source })?;
    let damaged = |source| ReplayError::Read { path: path.clone(), source };
    let mut reader = RecordingReader::new(BufReader::new(file)).map_err(damaged)?;
    let header = reader.header().clone();
    let table = CellTable::new(cells::beam_lift::cell()).ok().filter(|table| table.digest() == header.digest);
    let table = table.ok_or_else(|| ReplayError::OtherCell {
        path: path.clone(),
        cell: header.cell.clone(),
        digest: header.digest,
    })?;
    let mut logs: BTreeMap<TaskId, Log> = BTreeMap::new();
    while let Some(record) = reader.next_record().map_err(damaged)? {
        match record {
            Record::Input { task, elapsed, input, outputs } => {
                let log = logs.entry(task).or_default();
                if log.lost == 0 {
                    let step = Step { elapsed, input };
                    log.steps.push(Recorded { step, digest: OutputDigest(outputs) });
                }
            }
            Record::Gap { stream: Stream::Task(task), lost } => logs.entry(task).or_default().lost += lost,
            Record::Gap { stream: Stream::Frames(_), .. }
            | Record::Header(_)
            | Record::Keyframe { .. }
            | Record::Frame { .. }
            | Record::End => {}
        }
    }
    let known = |node: &NodeId| node.index() < table.cell().nodes.len();
    let node = header.node.filter(known).ok_or_else(|| ReplayError::NoInputs(path.clone()))?;
    let name = table.cell().nodes[node.index()].name.clone();
    let table = NodeTable::new(Arc::new(table), node);
    let mut tasks = Vec::new();
    for (task, log) in logs {
        if table.location(task) != Some(node) {
            continue;
        }
        let recorded = log.steps.len();
        let (steps, divergence) = match replay(&table, task, header.incarnation, header.restarted, log.steps)
        {
            Ok(steps) => (steps, None),
            Err(divergence) => (divergence.index.min(recorded), Some(divergence.to_string())),
        };
        tasks.push(Task {
            name: table.cell.cell().tasks[task.index()].name.clone(),
            steps,
            lost: log.lost,
            divergence,
        });
    }
    Ok(Replayed {
        version: 1,
        cell: header.cell,
        node: name,
        build: header.build,
        insecure: header.insecure,
        whole: reader.ending() == Ending::Ended,
        tasks,
    })
}

fn show(replayed: &Replayed, out: &mut Output) -> Result<(), Failure> {
    out.line(format!("node {} of cell {}, recorded by {}", replayed.node, replayed.cell, replayed.build))?;
    for task in &replayed.tasks {
        let steps = count(task.steps as u64, "step");
        match (&task.divergence, task.lost) {
            (Some(how), _) => out.line(format!("  {}: {} {how}", task.name, Styled(BAD, "differs:")))?,
            (None, 0) => {
                out.line(format!("  {}: {steps}, {}", task.name, Styled(GOOD, "every output the same")))?;
            }
            (None, lost) => out.line(format!(
                "  {}: {steps}, every output the same; then {lost} inputs are missing, and the rest is {}",
                task.name,
                Styled(NOTE, "unknown")
            ))?,
        }
    }
    if !replayed.whole {
        out.line(Styled(NOTE, "  The recording was cut off: it has no end."))?;
    }
    Ok(())
}
