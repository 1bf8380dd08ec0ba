//! Checks whether running nodes behave as verified. A validator, which the command provides, replays the recordings in
//! which nodes write their inputs. The monitor itself contains no state machine.

use crate::source::{Feed, Sink, SourceId};
use crate::store::conformance::Conformance;
use imrs_wire::obs::ServerFrame;
use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// The pause between two passes over all recordings, unless a pass did not reach the end of a recording.
const PAUSE: Duration = Duration::from_millis(500);
/// The greatest number of recordings that are judged.
const RECORDINGS: usize = 64;

/// The result for one recording.
#[derive(Clone, Debug)]
pub struct Judgement {
    /// The name of the recorded cell.
    pub cell: String,
    /// The name of the recorded node.
    pub node: String,
    /// The node's incarnation.
    pub incarnation: u8,
    /// The verdict on the recording.
    pub said: Conformance,
    /// Whether the recording has records that this pass did not reach.
    pub behind: bool,
}

/// A validator: replays recordings and compares them with the state machine.
pub trait Judge: Send + Sync + fmt::Debug {
    /// Starts a session, which keeps the state between two passes over the recordings.
    fn sit(&self) -> Box<dyn FollowSession + '_>;
}

/// A session that judges recordings while they grow.
pub trait FollowSession {
    /// Judges the records of a recording that were added since the last call. Returns `None` if the recording does not
    /// name its node. A call takes less than a second; the next call continues where it ended.
    fn look(&mut self, recording: &Path) -> Option<Judgement>;
}

/// The conformance worker: a thread that judges the recordings that nodes announce.
#[derive(Clone)]
pub(crate) struct ConformanceWorker {
    told: Arc<Mutex<BTreeSet<PathBuf>>>,
    /// Ends the thread: it is dropped with the last clone of this worker.
    _open: Option<SyncSender<()>>,
}

impl ConformanceWorker {
    /// Starts the worker, which delivers its results to `sink`. Without a judge no worker is started.
    pub fn open(judge: Option<Arc<dyn Judge>>, sink: Sink) -> Self {
        let told = Arc::new(Mutex::new(BTreeSet::new()));
        let open = judge.and_then(|judge| {
            let (open, ended) = sync_channel(0);
            let recordings = Arc::clone(&told);
            let sit = move || sit(judge.as_ref(), &recordings, &sink, &ended);
            // If no thread can be started, no recording is judged, and the screen says so.
            thread::Builder::new().name("imrs-judge".into()).spawn(sit).ok().map(|_| open)
        });
        Self { told, _open: open }
    }

    /// Notes the path of the recording that a node announces.
    pub fn hear(&self, feed: &Feed) {
        let Feed::Frame(frame) = feed else { return };
        let ServerFrame::Vitals(vitals) = &**frame else { return };
        if let Some(facts) = &vitals.recording {
            let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
            if told.len() < RECORDINGS {
                told.insert(PathBuf::from(&facts.path));
            }
        }
    }
}

fn sit(judge: &dyn Judge, told: &Mutex<BTreeSet<PathBuf>>, sink: &Sink, ended: &Receiver<()>) {
    let mut session = judge.sit();
    let mut pause = PAUSE;
    while ended.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
        pause = PAUSE;
        let recordings = told.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for recording in recordings {
            let Some(judgement) = session.look(&recording) else { continue };
            let Judgement { cell, node, incarnation, said, behind } = judgement;
            if behind {
                pause = Duration::ZERO;
            }
            let feed = Feed::Judged { cell, node, incarnation, said: Box::new(said) };
            // No source has this number: the result itself names its node.
            if !sink.deliver(SourceId(u32::MAX), feed) {
                return;
            }
        }
    }
}
