//! Writes down what goes into the communication tasks of a node (D62).

use super::lines::Setup;
use crate::cells::Loaded;
use crate::output::complain;
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
pub struct NodeRecording(Arc<FileRecorder>);

impl NodeRecording {
    /// Begins a recording in a new file, which only its owner can read.
    ///
    /// # Errors
    /// The file cannot be made or written.
    pub fn start(path: &Path, setup: &Setup, loaded: &Loaded, table: &NodeTable) -> Result<Self, WriteError> {
        let file = files::create(path).map_err(io::Error::from)?;
        let name = path.display().to_string();
        let failed = move |error: &WriteError| complain(format_args!("{name} is no longer written: {error}"));
        let about = About {
            life: (Incarnation(setup.incarnation), setup.restarted),
            insecure: true,
            build: concat!("imrs ", env!("CARGO_PKG_VERSION")),
            statements: loaded.statements(table.node),
        };
        Ok(Self(FileRecorder::start(file, table, &about, failed)?))
    }

    /// Who is told of every input.
    pub fn recorder(&self) -> Arc<dyn Recorder> {
        Arc::clone(&self.0) as Arc<dyn Recorder>
    }

    /// How it goes, for monitors.
    pub fn watch(&self, path: &Path) -> RecordingWatch {
        let (recorder, path) = (Arc::clone(&self.0), path.display().to_string());
        Arc::new(move || {
            let status = recorder.status()?;
            Some(RecordingFacts { path: path.clone(), lost: status.lost, failure: status.failure })
        })
    }

    /// Ends the recording and says how it went.
    pub fn stop(self, patience: Duration) -> Option<Status> {
        self.0.stop(patience)
    }
}
