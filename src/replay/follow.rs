//! Replays recordings while they are still being written, so that the monitor can judge running nodes.
//!
//! The state machines and the reader keep their state between two calls, so a call costs time only for new records.

use super::{Opened, divergence, open};
use imrs_launch::cells::Loaded;
use imrs_monitor::judge::{FollowSession, Judgement};
use imrs_monitor::store::conformance::{self, Conformance};
use imrs_protocol::{Cell, NodeId, NodeTable};
use imrs_runtime::record::Replays;
use imrs_wire::files;
use imrs_wire::recording::{Header, RecordingReader};
use std::collections::BTreeMap;
use std::fs::{File, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The time limit for one recording in one call; the next call continues.
const SLICE: Duration = Duration::from_millis(250);
/// The number of records between two readings of the clock.
const CHUNK: usize = 4_096;

/// The cells whose recordings can be replayed.
pub struct Cells {
    known: Vec<Loaded>,
    /// For each cell, the tables of its nodes.
    tables: Vec<Vec<NodeTable>>,
    /// The file of the only cell, if the user named that file.
    given: Option<String>,
}

impl Cells {
    /// Makes the value from compiled cells. `given` is the file of the only cell, if the user named that file.
    pub fn new(known: Vec<Loaded>, given: Option<String>) -> Self {
        let tables = |cell: &Loaded| {
            let nodes = (0..cell.table.cell().nodes.len()).map(NodeId::from_index);
            nodes.map(|node| NodeTable::new(Arc::clone(&cell.table), node)).collect()
        };
        Self { tables: known.iter().map(tables).collect(), known, given }
    }

    /// The file of the only cell, if the user named that file.
    pub fn given(&self) -> Option<&str> {
        self.given.as_deref()
    }

    /// Begins to follow recordings.
    pub const fn follow(&self) -> Following<'_> {
        Following { cells: self, files: BTreeMap::new() }
    }

    fn open(&self, path: &Path, header: &Header) -> Result<(RecordingReader<File>, Replays<'_>), String> {
        let Opened { reader, table, cell, .. } =
            open(path, &self.known, self.given.as_deref()).map_err(|error| error.to_string())?;
        let at = self.known.iter().position(|known| std::ptr::eq(known, cell));
        let own = at.and_then(|at| self.tables.get(at)?.get(table.node.index()));
        let own = own.ok_or_else(|| format!("node {} is not of this cell", table.node.index()))?;
        let replays = Replays::begin(header, own, |task| cell.program(task), None);
        Ok((reader, replays.map_err(|error| error.to_string())?))
    }
}

/// The recordings that are being followed.
pub struct Following<'a> {
    cells: &'a Cells,
    files: BTreeMap<PathBuf, Followed<'a>>,
}

impl FollowSession for Following<'_> {
    fn look(&mut self, recording: &Path) -> Option<Judgement> {
        let present = std::fs::metadata(recording).ok()?;
        let same = self.files.get(recording).is_some_and(|file| file.is_of(&present));
        if !same {
            self.files.insert(recording.to_owned(), Followed::open(recording, &present, self.cells)?);
        }
        self.files.get_mut(recording).map(|file| file.look(&present))
    }
}

struct Followed<'a> {
    /// Device number and inode of the file.
    identity: (u64, u64),
    header: Header,
    cell: &'a Cell,
    /// The name of the recording's node.
    node: String,
    /// The reader and the replays, or why the replay cannot go on.
    runs: Result<(RecordingReader<File>, Replays<'a>), String>,
}

fn identity(file: &Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

impl<'a> Followed<'a> {
    /// Begins to replay a file; `None` if the file cannot be read, or its cell is not known.
    fn open(path: &Path, present: &Metadata, cells: &'a Cells) -> Option<Self> {
        let header = RecordingReader::new(files::open(path).ok()?).ok()?.header().clone();
        let cell = cells.known.iter().find(|cell| cell.table.digest() == header.digest)?.table.cell();
        let node = cell.nodes.get(header.node?.index())?.name.clone();
        let runs = cells.open(path, &header);
        Some(Self { identity: identity(present), header, cell, node, runs })
    }

    /// Whether the path still leads to the same file: another file may have taken the name, or the file may have been
    /// truncated.
    fn is_of(&self, present: &Metadata) -> bool {
        let read = self.runs.as_ref().map_or(0, |(reader, _)| reader.offset());
        identity(present) == self.identity && present.len() >= read
    }

    fn look(&mut self, present: &Metadata) -> Judgement {
        let (mut behind, begins) = (false, Instant::now());
        while let Ok((reader, replays)) = &mut self.runs {
            match replays.go_on(reader, CHUNK) {
                Ok(CHUNK) => behind = begins.elapsed() > SLICE,
                Ok(_) => break,
                Err(error) => self.runs = Err(error.to_string()),
            }
            if behind {
                break;
            }
        }
        let said = match &self.runs {
            Err(why) => Conformance::unknown(why),
            Ok((reader, replays)) => {
                let read = reader.offset().saturating_mul(100) / present.len().max(1);
                said_of(replays, self.cell, behind.then_some(read))
            }
        };
        let (cell, incarnation) = (self.header.cell.clone(), self.header.incarnation.0);
        Judgement { cell, node: self.node.clone(), incarnation, said, behind }
    }
}

/// The verdict so far. `read` says which part of the recording has been replayed, in percent; `None` if all of it.
fn said_of(replays: &Replays<'_>, cell: &Cell, read: Option<u64>) -> Conformance {
    let steps = replays.iter().map(|replay| replay.judged() as u64).sum();
    let missing: u64 = replays.iter().map(|replay| replay.lost() + replay.unjudged() as u64).sum();
    let differs = replays.iter().find_map(|replay| {
        let name = cell.tasks.get(replay.task().index()).map_or("?", |task| task.name.as_str());
        let what = divergence(replay.verdict(), name)?;
        Some((replay.judged() as u64, what))
    });
    let verdict = match (differs, read) {
        (Some((step, what)), _) => conformance::Verdict::Violates { step, what },
        (None, _) if missing > 0 => {
            conformance::Verdict::Unknown { why: format!("{missing} inputs are missing in its recording") }
        }
        (None, Some(read)) => {
            let why = format!("{read} % of its recording has been run again so far, all as verified");
            conformance::Verdict::Unknown { why }
        }
        (None, None) => conformance::Verdict::Conforms,
    };
    Conformance { verdict, steps }
}
