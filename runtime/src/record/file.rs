//! Recording into a file, by a thread of its own: the node hands every step over and goes on.

use super::{OutputDigest, Recorder, Step};
use imrs_protocol::{CommTask, Incarnation, NodeTable, TaskId};
use imrs_wire::recording::{Header, Recording, ScriptStep, Status, TaskStream, WriteError};
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How many steps wait between a node and its disk. When there are more, a gap is recorded instead; once the disk keeps
/// up again, the recording goes on with a keyframe.
const CAPACITY: usize = 32_768;

/// Records the inputs of a node's communication tasks as an [`imrs_wire::recording`].
pub struct FileRecorder {
    recording: Mutex<Option<Recording>>,
    /// One for each task of the node, ascending. Their locks are never waited for: each is used under the lock of its
    /// communication task only.
    tracks: Box<[Mutex<Track>]>,
    tasks: Box<[TaskId]>,
}

struct Track {
    stream: TaskStream,
    /// How many steps there were.
    inputs: u64,
    /// The digest of all outputs.
    outputs: OutputDigest,
    /// Nothing comes after the last record of the task, though an action of it may still end.
    closed: bool,
}

/// Whose recording it is.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// The life of the node, and whether an earlier one may have taken requests.
    pub life: (Incarnation, bool),
    /// Whether its links run without keys.
    pub insecure: bool,
    /// Names the program.
    pub build: &'a str,
    /// The digest of what its scripts do ([`statements`](super::statements)).
    pub statements: u32,
}

impl FileRecorder {
    /// Begins to record a node. `on_failure` is called at most once, when the disk fails: the node goes on, unrecorded.
    ///
    /// # Errors
    /// Where not even the beginning can be written.
    pub fn start(
        sink: impl Write + Send + 'static,
        table: &NodeTable,
        about: &About<'_>,
        on_failure: impl FnOnce(&WriteError) + Send + 'static,
    ) -> Result<Arc<Self>, WriteError> {
        let began = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let header = Header {
            cell: table.cell().name.clone(),
            digest: table.digest(),
            statements: about.statements,
            node: Some(table.node),
            incarnation: about.life.0,
            restarted: about.life.1,
            build: about.build.into(),
            insecure: about.insecure,
            began: u64::try_from(began.as_micros()).unwrap_or(u64::MAX),
        };
        let recording = Recording::start(sink, &header, CAPACITY, on_failure)?;
        let tasks: Box<[TaskId]> = table.tasks_on(table.node).collect();
        let track = |&task: &TaskId| {
            let stream = recording.task(task);
            Mutex::new(Track { stream, inputs: 0, outputs: OutputDigest::START, closed: false })
        };
        let tracks = tasks.iter().map(track).collect();
        Ok(Arc::new(Self { recording: Mutex::new(Some(recording)), tracks, tasks }))
    }

    /// How the recording is doing; `None` once it was stopped.
    #[must_use]
    pub fn status(&self) -> Option<Status> {
        self.recording.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(Recording::status)
    }

    /// Ends the recording: to be called after the node has stopped. Waits for the disk as long as `patience`. `None`
    /// where it was stopped before.
    pub fn stop(&self, patience: Duration) -> Option<Status> {
        let recording = self.recording.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        for track in &self.tracks {
            let mut track = track.lock().unwrap_or_else(PoisonError::into_inner);
            let (inputs, outputs) = (track.inputs, track.outputs.0);
            track.closed = true;
            track.stream.close(inputs, outputs);
        }
        Some(recording.stop(patience))
    }

    fn with(&self, task: TaskId, write: impl FnOnce(&mut Track)) {
        if let Ok(at) = self.tasks.binary_search(&task) {
            let mut track = self.tracks[at].lock().unwrap_or_else(PoisonError::into_inner);
            if !track.closed {
                write(&mut track);
            }
        }
    }
}

impl Recorder for FileRecorder {
    fn step(&self, task: TaskId, Step { elapsed, input }: Step, digest: OutputDigest) -> bool {
        let mut wanted = false;
        self.with(task, |track| {
            (track.inputs, track.outputs) = (track.inputs + 1, digest);
            wanted = !track.stream.input(elapsed, input, digest.0) && track.stream.wants_keyframe();
        });
        wanted
    }

    fn script(&self, task: TaskId, step: ScriptStep, done: OutputDigest) {
        self.with(task, |track| {
            track.stream.script(step, done.0);
        });
    }

    /// Allocates, unlike everything else on a message's way: once for each gap.
    fn keyframe(&self, machine: &CommTask, digest: OutputDigest) {
        // A state that cannot be written down is as good as none: the gap goes on.
        let Ok(state) = postcard::to_allocvec(machine) else { return };
        self.with(machine.task(), |track| {
            track.stream.keyframe(state, digest.0);
        });
    }
}
