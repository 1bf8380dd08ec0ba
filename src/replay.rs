//! `imrs replay`: runs the recorded inputs of a node through the state machine again, and compares every output.

mod assumptions;
pub mod error;
mod follow;
mod path;
mod surroundings;
mod told;

pub use follow::Cells;

use crate::args::{Format, ReplayArgs};
use crate::cell_file;
use crate::demo;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count};
use error::ReplayError;
use imrs_launch::cells::{self, Loaded};
use imrs_protocol::{NodeId, NodeTable};
use imrs_runtime::record::{
    Divergence, InvariantBroken, Miscount, ScriptDivergence, Verdict, replay_scripts,
};
use imrs_wire::files;
use imrs_wire::recording::{Ending, Header, RecordingReader};
use imrs_wire::text::one_line;
use serde::Serialize;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The result of replaying one recording.
#[derive(Debug, Serialize)]
struct Replayed {
    version: u32,
    cell: String,
    node: String,
    build: String,
    insecure: bool,
    /// Whether the recording has its end record.
    whole: bool,
    /// Whether the recording has its end record, and every step could be judged.
    complete: bool,
    tasks: Vec<Task>,
}

/// The result of replaying one task.
#[derive(Debug, Serialize)]
struct Task {
    name: String,
    /// How many steps gave the same outputs as in the recording.
    steps: usize,
    /// How many recorded steps could not be judged, because the state before them is not known.
    unjudged: usize,
    /// How many inputs were not recorded.
    lost: u64,
    /// `same`, `unknown` (a part of the recording is missing) or `differs`.
    verdict: &'static str,
    /// A text about the first step whose outputs differ; `None` if there is no such step.
    divergence: Option<String>,
}

impl Task {
    /// Whether all steps of the task could be judged.
    const fn is_judged(&self) -> bool {
        self.lost == 0 && self.unjudged == 0
    }
}

/// Replays the recordings that the user named.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    if args.model {
        return path::run(args, out);
    }
    let (given, known) = match &args.cell {
        Some(path) => (Some(cell_file::shown(path)), vec![cells::open(path, args.paper)?.1]),
        None => (None, demo::cells().collect()),
    };
    let mut exit = Exit::Well;
    for file in &args.files {
        let replayed = read(file, &known, given.as_deref())?;
        if replayed.tasks.iter().any(|task| task.divergence.is_some()) {
            exit = Exit::Finding;
        } else if !replayed.complete && exit == Exit::Well {
            exit = Exit::Incomplete;
        }
        match args.format {
            Format::Json => out.json(&replayed)?,
            Format::Text => show(&replayed, out)?,
        }
    }
    Ok(exit)
}

/// A recording of a node, and the known cell to which it belongs.
struct Opened<'a> {
    reader: RecordingReader<File>,
    header: Header,
    table: NodeTable,
    cell: &'a Loaded,
}

/// Opens a recording of one of the `known` cells. If the user named the only cell, `given` is its file.
fn open<'a>(path: &Path, known: &'a [Loaded], given: Option<&str>) -> Result<Opened<'a>, ReplayError> {
    let own = || path.to_owned();
    let file = files::open(path).map_err(|source| ReplayError::Open { path: own(), source })?;
    let reader = RecordingReader::new(file)
        .map_err(|error| ReplayError::Read { path: own(), source: error.into() })?;
    let mut header = reader.header().clone();
    for text in [&mut header.cell, &mut header.build] {
        *text = one_line(text).into_owned();
    }
    let node = header.node.ok_or_else(|| ReplayError::Observations(own()))?;
    let cell = known.iter().find(|cell| cell.table.digest() == header.digest);
    let cell = cell.ok_or_else(|| other_cell(own(), &header, known, given))?;
    let declared = |node: &NodeId| node.index() < cell.table.cell().nodes.len();
    let node = Some(node).filter(declared).ok_or_else(|| ReplayError::NoInputs(own()))?;
    let (recorded, now) = (header.statements, cell.statements(node));
    if recorded != now {
        let given = given.unwrap_or("the demo of this program").to_owned();
        let cell = header.cell;
        return Err(ReplayError::OtherText { path: own(), cell, given, what: "statements", recorded, now });
    }
    Ok(Opened { reader, header, table: NodeTable::new(Arc::clone(&cell.table), node), cell })
}

fn other_cell(path: PathBuf, header: &Header, known: &[Loaded], given: Option<&str>) -> ReplayError {
    let (cell, recorded) = (header.cell.clone(), header.digest);
    let Some((given, only)) = given.zip(known.first()) else {
        return ReplayError::OtherCell { path, cell, digest: recorded };
    };
    let (given, other, now) = (given.to_owned(), only.table.cell().name.clone(), only.table.digest());
    if cell == other {
        ReplayError::OtherText { path, cell, given, what: "declarations", recorded, now }
    } else {
        ReplayError::NotThisCell { path, cell, given, other, recorded, now }
    }
}

fn read(path: &Path, known: &[Loaded], given: Option<&str>) -> Result<Replayed, ReplayError> {
    let Opened { mut reader, header, table, cell } = open(path, known, given)?;
    let names = table.cell.cell();
    let damaged = |source| ReplayError::Read { path: path.to_owned(), source };
    let replays = replay_scripts(&mut reader, &table, |task| cell.program(task), None).map_err(damaged)?;
    let tasks = replays.iter().map(|replay| Task {
        name: names.tasks[replay.task().index()].name.clone(),
        steps: replay.judged(),
        unjudged: replay.unjudged(),
        lost: replay.lost(),
        verdict: match replay.verdict() {
            Verdict::Same => "same",
            Verdict::Unknown => "unknown",
            Verdict::Differs(_) | Verdict::ScriptDiffers(_) | Verdict::Breaks(_) | Verdict::Miscounts(_) => {
                "differs"
            }
        },
        divergence: divergence(replay.verdict(), &names.tasks[replay.task().index()].name),
    });
    let (tasks, whole): (Vec<Task>, _) = (tasks.collect(), reader.ending() == Ending::Ended);
    Ok(Replayed {
        version: 1,
        cell: header.cell,
        node: names.nodes[table.node.index()].name.clone(),
        build: header.build,
        insecure: header.insecure,
        complete: whole && tasks.iter().all(Task::is_judged),
        tasks,
        whole,
    })
}

/// A text about how a task of this name differs from its recording; `None` if it does not differ.
fn divergence(verdict: Verdict, name: &str) -> Option<String> {
    match verdict {
        Verdict::Differs(Divergence { index, .. }) => {
            Some(format!("with recorded step {index} `{name}` puts out something else than recorded"))
        }
        Verdict::ScriptDiffers(ScriptDivergence { index, .. }) => Some(format!(
            "after recorded step {index} the statements of `{name}` do something else than recorded"
        )),
        Verdict::Breaks(InvariantBroken { index, violation, .. }) => Some(format!(
            "after recorded step {index} an invariant of the machine does not hold: {violation}"
        )),
        Verdict::Miscounts(Miscount { said, found, .. }) if said != found => Some(format!(
            "its last record says that `{name}` took {}, and {found} are there",
            count(said, "input")
        )),
        Verdict::Miscounts(_) => {
            Some(format!("its last record says that `{name}` put out something else than its inputs lead to"))
        }
        Verdict::Same | Verdict::Unknown => None,
    }
}

fn show(replayed: &Replayed, out: &mut Output) -> Result<(), Failure> {
    out.line(format!("node {} of cell {}, recorded by {}", replayed.node, replayed.cell, replayed.build))?;
    if replayed.insecure {
        let words = "INSECURE: the node ran without keys, so other processes could forge its packets";
        out.line(format!("  {}", Styled(BAD, words)))?;
    }
    for task in &replayed.tasks {
        let steps = count(task.steps as u64, "step");
        match (&task.divergence, task.lost + task.unjudged as u64) {
            (Some(how), _) => out.line(format!("  {}: {} {how}", task.name, Styled(BAD, "differs:")))?,
            (None, 0) => {
                out.line(format!("  {}: {steps}, {}", task.name, Styled(GOOD, "every output the same")))?;
            }
            (None, _) => out.line(format!(
                "  {}: {steps}, every output the same; {} inputs are missing and {} could not be judged: {}",
                task.name,
                task.lost,
                task.unjudged,
                Styled(NOTE, "unknown")
            ))?,
        }
    }
    if !replayed.whole {
        out.line(Styled(NOTE, "  The recording was cut off: it has no end."))?;
    }
    if !replayed.complete {
        out.line(Styled(NOTE, "  Incomplete: what is missing was not judged."))?;
    }
    Ok(())
}
