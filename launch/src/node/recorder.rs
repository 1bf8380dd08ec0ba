//! Records the inputs of a node's communication tasks (D62).

use crate::cells::Loaded;
use crate::host::Host;
use crate::pipe::Setup;
use crate::words::count;
use imrs_protocol::{Incarnation, NodeTable};
use imrs_runtime::observer::RecordingWatch;
use imrs_runtime::record::{About, FileRecorder, Recorder};
use imrs_wire::files;
use imrs_wire::obs::RecordingFacts;
use imrs_wire::recording::{Status, WriteError};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// A recording of one node.
pub struct NodeRecording {
    recorder: Arc<FileRecorder>,
    path: String,
}

impl NodeRecording {
    /// Begins a recording in a new file that only its owner can read. The node must have bound its socket and locked its
    /// incarnation before: only then may it replace the recording of an earlier run, if `--force` allows that (D151).
    ///
    /// # Errors
    /// An error if the file cannot be created or written.
    pub fn start(
        host: &'static dyn Host,
        path: &Path,
        setup: &Setup,
        loaded: &Loaded,
        table: &NodeTable,
    ) -> Result<Self, WriteError> {
        let made = files::free(path, setup.force).and_then(|()| files::create(path));
        let file = made.map_err(io::Error::from)?;
        let path = path.display().to_string();
        let name = path.clone();
        let failed =
            move |error: &WriteError| host.complain(&format_args!("{name} is no longer written: {error}"));
        let about = About {
            incarnation: (Incarnation(setup.incarnation), setup.restarted),
            insecure: setup.insecure,
            build: concat!("imrs ", env!("CARGO_PKG_VERSION")),
            statements: loaded.statements(table.node),
        };
        Ok(Self { recorder: FileRecorder::start(file, table, &about, failed)?, path })
    }

    /// The recorder that receives every input of the node.
    pub fn recorder(&self) -> Arc<dyn Recorder> {
        Arc::clone(&self.recorder) as Arc<dyn Recorder>
    }

    /// The status of the recording, for monitors.
    pub fn watch(&self, path: &Path) -> RecordingWatch {
        let (recorder, path) = (Arc::clone(&self.recorder), path.display().to_string());
        Arc::new(move || {
            let status = recorder.status()?;
            Some(RecordingFacts { path: path.clone(), lost: status.lost, failure: status.failure })
        })
    }

    /// What the recording lacks so far, in words; `None` if it is complete so far.
    pub fn missing(&self) -> Option<String> {
        self.recorder.status().and_then(|status| self.words(&status))
    }

    /// Ends the recording. Returns what the recording lacks, in words; `None` if it is complete.
    pub fn stop(self, patience: Duration) -> Option<String> {
        let status = self.recorder.stop(patience)?;
        self.words(&status)
            .or_else(|| (!status.ended).then(|| format!("the recording {} has no end", self.path)))
    }

    fn words(&self, status: &Status) -> Option<String> {
        let path = &self.path;
        match status {
            Status { failure: Some(why), .. } => Some(format!("the recording {path} ends early: {why}")),
            Status { lost: 0, .. } => None,
            Status { lost, .. } => Some(format!("the recording {path} misses {}", count(*lost, "input"))),
        }
    }
}
