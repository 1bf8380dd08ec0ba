//! Records the frames of every node as they arrive, for `--replay`.

use crate::clock::{Moment, micros};
use crate::error::MonitorError;
use crate::source::{Arrival, Feed, SourceId, Wishes};
use imrs_wire::files;
use imrs_wire::obs::{Hello, NodeIdentity, Role, SCHEMA, ServerFrame, VERSION};
use imrs_wire::recording::{FrameStream, Header, Recording, Shown, Status};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How many frames may wait for the disk. Frames beyond that are counted as lost.
const ROOM: usize = 1024;
/// How long the end of a recording may wait for the disk.
const PATIENCE: Duration = Duration::from_secs(2);

/// The recorder. It always keeps the frames with which a recording must begin, so that a recording can start at any time.
#[derive(Default)]
pub struct Tape {
    inner: Mutex<Inner>,
    /// Makes the nodes send whole snapshots, with which a recording begins.
    wishes: Wishes,
}

#[derive(Default)]
struct Inner {
    known: BTreeMap<SourceId, Known>,
    asked: Option<Asked>,
    running: Option<Running>,
    /// A recording that could not begin, with the reason.
    failed: Option<(PathBuf, String)>,
}

/// A recording that has a file and waits for its header: only the first state of a node says whether it runs without keys.
/// The nodes of a cell either all have keys or all have none, so the first one decides.
struct Asked {
    path: PathBuf,
    file: File,
    began: Moment,
}

/// What is known of a source: the identity of its node, and the names of its cell.
struct Known {
    identity: NodeIdentity,
    attached: Vec<u8>,
    table: Option<Vec<u8>>,
    /// Whether the node runs without keys, once it has said so.
    insecure: Option<bool>,
}

struct Running {
    path: PathBuf,
    recording: Recording,
    streams: BTreeMap<SourceId, FrameStream>,
    began: Moment,
    /// The sources of which the recording contains a state to which deltas can be applied.
    whole: BTreeSet<SourceId>,
}

impl Running {
    /// Whether a frame can be interpreted when the recording is replayed, after the frames recorded so far.
    fn follows(&mut self, source: SourceId, frame: &ServerFrame) -> bool {
        match frame {
            ServerFrame::Snapshot(_) => {
                self.whole.insert(source);
                true
            }
            ServerFrame::Delta(delta) if delta.is_whole() => {
                self.whole.insert(source);
                true
            }
            ServerFrame::Delta(_) => self.whole.contains(&source),
            // Clocks and addresses mean nothing when the recording is replayed.
            ServerFrame::Pong(_)
            | ServerFrame::Places(_)
            | ServerFrame::Denied(_)
            | ServerFrame::Challenge(_) => false,
            ServerFrame::Table(_)
            | ServerFrame::Events(_)
            | ServerFrame::Bye(_)
            | ServerFrame::Detail(_)
            | ServerFrame::Vitals(_)
            | ServerFrame::Links(_)
            | ServerFrame::HeldBack(_) => true,
        }
    }

    /// Records a frame. Returns false if the frame was lost, so that later deltas have no base.
    fn put(&mut self, at: Moment, source: SourceId, bytes: Vec<u8>) -> bool {
        // The numbers of sources in a recording have 16 bits. A source with a larger number is not recorded.
        let Ok(number) = u16::try_from(source.0) else { return true };
        let recording = &self.recording;
        let stream = self.streams.entry(source).or_insert_with(|| recording.frames(number));
        let at = micros(at.saturating_sub(self.began));
        // If there is no room, the stream counts a loss and the recording contains a gap.
        let kept = stream.frame(at, bytes);
        if !kept {
            self.whole.remove(&source);
        }
        kept
    }
}

/// The result of a recording.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The path of the recording.
    pub path: PathBuf,
    /// The size of the recording, and errors.
    pub status: Status,
}

impl Tape {
    /// What the recorder wants from the nodes: whole snapshots. The owner of this recorder passes this subscription to
    /// the sources.
    #[must_use]
    pub const fn wishes(&self) -> &Wishes {
        &self.wishes
    }

    /// Records an arrival from a source, if a recording runs.
    pub fn take(&self, arrival: &Arrival) {
        let mut inner = self.inner();
        let Arrival { at, source, feed } = arrival;
        let bytes = match feed {
            Feed::Attached { identity, pid, build } => {
                let role = Role::Node(identity.clone());
                let hello = Hello { schema: SCHEMA, pid: *pid, build: build.clone(), mono_us: 0, role };
                let attached = Shown::Attached { version: VERSION, hello }.encode();
                let (identity, attached_bytes) = (identity.clone(), attached.clone());
                let known = Known { identity, attached: attached_bytes, table: None, insecure: None };
                inner.known.insert(*source, known);
                attached
            }
            Feed::Frame(frame) => {
                if let (Some(insecure), Some(known)) = (says_insecure(frame), inner.known.get_mut(source)) {
                    known.insecure = Some(insecure);
                    inner.begin(*at);
                }
                let is_table = matches!(**frame, ServerFrame::Table(_));
                let follows = inner.running.as_mut().is_some_and(|running| running.follows(*source, frame));
                if !is_table && !follows {
                    return;
                }
                let bytes = Shown::Said((**frame).clone()).encode();
                if let Some(known) = inner.known.get_mut(source).filter(|_| is_table) {
                    known.table = Some(bytes.clone());
                }
                bytes
            }
            Feed::Lost { why } => {
                inner.known.remove(source);
                Shown::Lost { why: why.clone() }.encode()
            }
            Feed::Judged { .. } | Feed::Failed { .. } | Feed::Left | Feed::Stale { .. } => return,
        };
        if let Some(running) = &mut inner.running
            && !running.put(*at, *source, bytes)
        {
            self.wishes.want_whole();
        }
    }

    /// Starts a recording in a new file, which only the file's owner can read. The file stays empty until a node has sent
    /// its state.
    ///
    /// # Errors
    /// [`MonitorError::Recording`], also if the file exists.
    pub fn start(&self, path: &Path, now: Moment) -> Result<(), MonitorError> {
        let failed = |why: String| MonitorError::Recording { path: path.to_owned(), why };
        let mut inner = self.inner();
        let file = files::create(path).map_err(|error| failed(error.to_string()))?;
        inner.asked = Some(Asked { path: path.to_owned(), file, began: now });
        if inner.known.values().any(|known| known.insecure.is_some()) {
            inner.begin(now);
        }
        inner.failed.take().map_or(Ok(()), |(_, why)| Err(failed(why)))?;
        self.wishes.want_whole();
        Ok(())
    }

    /// Ends the recording, if one runs.
    pub fn stop(&self) -> Option<Recorded> {
        let mut inner = self.inner();
        if let Some(Asked { began, .. }) = inner.asked {
            inner.begin(began);
        }
        if let Some((path, why)) = inner.failed.take() {
            return Some(Recorded { path, status: Status { failure: Some(why), ..Status::default() } });
        }
        let running = inner.running.take()?;
        Some(Recorded { path: running.path, status: running.recording.stop(PATIENCE) })
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// Begins the recording that was asked for, if any, with what is known of the nodes.
    fn begin(&mut self, at: Moment) {
        let Some(Asked { path, file, began }) = self.asked.take() else { return };
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let first = self.known.values().next().map(|known| &known.identity);
        let header = Header {
            cell: first.map_or_else(String::new, |first| first.cell.clone()),
            digest: first.map_or(0, |first| first.digest),
            build: concat!("imrs-monitor ", env!("CARGO_PKG_VERSION")).into(),
            insecure: self.known.values().any(|known| known.insecure == Some(true)),
            began: u64::try_from(since.as_micros()).unwrap_or(0),
            ..Header::default()
        };
        let recording = match Recording::start(file, &header, ROOM, |_| {}) {
            Ok(recording) => recording,
            Err(error) => {
                self.failed = Some((path, error.to_string()));
                return;
            }
        };
        let (streams, whole) = (BTreeMap::new(), BTreeSet::new());
        let mut running = Running { path, recording, streams, began, whole };
        for (&source, known) in &self.known {
            for frame in [Some(&known.attached), known.table.as_ref()].into_iter().flatten() {
                running.put(at, source, frame.clone());
            }
        }
        self.running = Some(running);
    }
}

/// Whether a frame says that its node runs without keys; `None` if it says nothing about that.
fn says_insecure(frame: &ServerFrame) -> Option<bool> {
    match frame {
        ServerFrame::Snapshot(snapshot) => Some(snapshot.insecure),
        ServerFrame::Delta(delta) => delta.node.as_ref().map(|node| node.insecure),
        _ => None,
    }
}

/// Returns an error if the file exists; with `force` removes it instead.
///
/// # Errors
/// [`MonitorError::Recording`].
pub fn free(path: &Path, force: bool) -> Result<(), MonitorError> {
    let failed = |why: String| MonitorError::Recording { path: path.to_owned(), why };
    files::free(path, force).map_err(|error| failed(error.to_string()))
}

/// Returns `path` or, if that file exists, the next free name: `run.imrs`, `run-2.imrs`.
#[must_use]
pub fn free_name(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let end = path.extension().map_or_else(String::new, |end| format!(".{}", end.to_string_lossy()));
    let named = |number: u32| path.with_file_name(format!("{stem}-{number}{end}"));
    let mut names = std::iter::once(path.to_owned()).chain((2..=u32::MAX).map(named));
    names.find(|name| !name.exists()).unwrap_or_else(|| path.to_owned())
}
