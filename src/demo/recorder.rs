//! Writes down what goes into the communication tasks of a node (D62).

use super::lines::Setup;
use crate::output::complain;
use imrs_protocol::{CellTable, Incarnation, NodeId, TaskId};
use imrs_runtime::record::{OutputDigest, Recorder, Step};
use imrs_wire::recording::{Header, Recording, Status, TaskStream, WriteError};
use std::fs::OpenOptions;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How many inputs may wait for the disk: more than a second of the liveliest task.
const QUEUE: usize = 1 << 16;

/// A recording of one node, and who writes into it.
pub struct NodeRecording {
    recording: Recording,
    recorder: Arc<TaskRecorder>,
}

impl NodeRecording {
    /// Begins a recording in a new file, or over an old one.
    ///
    /// # Errors
    /// The file cannot be made or written.
    pub fn start(path: &Path, setup: &Setup, table: &CellTable, node: NodeId) -> Result<Self, WriteError> {
        let file = OpenOptions::new().write(true).create(true).truncate(true).open(path)?;
        let began = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let header = Header {
            cell: setup.cell.clone(),
            digest: table.digest(),
            node: Some(node),
            incarnation: Incarnation(setup.incarnation),
            restarted: false,
            build: concat!("imrs ", env!("CARGO_PKG_VERSION")).into(),
            insecure: true,
            began: u64::try_from(began.as_micros()).unwrap_or_default(),
        };
        let name = path.display().to_string();
        let failed = move |error: &WriteError| complain(format_args!("{name} is no longer written: {error}"));
        let recording = Recording::start(file, &header, QUEUE, failed)?;
        let stream = |task| Slot { stream: recording.task(task), step: None };
        let slots = table.tasks_on(node).map(|task| (task, Mutex::new(stream(task)))).collect();
        Ok(Self { recorder: Arc::new(TaskRecorder { slots }), recording })
    }

    /// Who is told of every input.
    pub fn recorder(&self) -> Arc<dyn Recorder> {
        Arc::clone(&self.recorder) as Arc<dyn Recorder>
    }

    /// Ends the recording.
    pub fn stop(self, patience: Duration) -> Status {
        self.recording.stop(patience)
    }
}

struct TaskRecorder {
    slots: Box<[(TaskId, Mutex<Slot>)]>,
}

struct Slot {
    stream: TaskStream,
    /// The input whose outputs are being made.
    step: Option<Step>,
}

impl TaskRecorder {
    /// Each task is recorded under its own lock of the node: nobody ever waits here.
    fn with(&self, task: TaskId, change: impl FnOnce(&mut Slot)) {
        if let Some((_, slot)) = self.slots.iter().find(|(of, _)| *of == task) {
            change(&mut slot.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}

impl Recorder for TaskRecorder {
    fn input(&self, task: TaskId, step: Step) {
        self.with(task, |slot| slot.step = Some(step));
    }

    fn output(&self, task: TaskId, digest: OutputDigest) {
        self.with(task, |slot| {
            if let Some(step) = slot.step.take() {
                slot.stream.input(step.elapsed, step.input, digest.0);
            }
        });
    }
}
