//! Whether running nodes do what was verified: the recordings that they write of their inputs are run again, by a validator
//! that the command brings along. The monitor itself has no machine to run.

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

/// Recordings are looked at no more often than this, unless there is more than one look takes in.
const PAUSE: Duration = Duration::from_millis(500);
/// More recordings than a cell has nodes are not judged.
const RECORDINGS: usize = 64;

/// What was found in a recording.
#[derive(Clone, Debug)]
pub struct Judgement {
    /// The name of the cell.
    pub cell: String,
    /// The node.
    pub node: String,
    /// Which of its lives.
    pub incarnation: u8,
    /// What was found.
    pub said: Conformance,
    /// Whether more has been written than was looked at.
    pub behind: bool,
}

/// Runs recordings again.
pub trait Judge: Send + Sync + fmt::Debug {
    /// Begins: what it remembers of recordings from one look to the next is the sitting's.
    fn sit(&self) -> Box<dyn Sitting + '_>;
}

/// Recordings that are followed.
pub trait Sitting {
    /// What is in a recording, with what was written since the last look at it; none where it says of no node what it is.
    /// A look takes less than a second; another one goes on.
    fn look(&mut self, recording: &Path) -> Option<Judgement>;
}

/// Judges the recordings that nodes tell of, in a thread of its own.
#[derive(Clone)]
pub(crate) struct Court {
    told: Arc<Mutex<BTreeSet<PathBuf>>>,
    /// Dropped with the last clone: the thread ends.
    _open: Option<SyncSender<()>>,
}

impl Court {
    /// Delivers what `judge` finds to `sink`. Without a judge nothing is ever judged.
    pub fn open(judge: Option<Arc<dyn Judge>>, sink: Sink) -> Self {
        let told = Arc::new(Mutex::new(BTreeSet::new()));
        let open = judge.and_then(|judge| {
            let (open, ended) = sync_channel(0);
            let recordings = Arc::clone(&told);
            let sit = move || sit(judge.as_ref(), &recordings, &sink, &ended);
            // Without a thread to give nothing is judged, and the screen says so.
            thread::Builder::new().name("imrs-judge".into()).spawn(sit).ok().map(|_| open)
        });
        Self { told, _open: open }
    }

    /// Takes note of where a node records.
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
    let mut sitting = judge.sit();
    let mut pause = PAUSE;
    while ended.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
        pause = PAUSE;
        let recordings = told.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for recording in recordings {
            let Some(judgement) = sitting.look(&recording) else { continue };
            let Judgement { cell, node, incarnation, said, behind } = judgement;
            if behind {
                pause = Duration::ZERO;
            }
            let feed = Feed::Judged { cell, node, incarnation, said: Box::new(said) };
            // From nobody: it names the node that it is about.
            if !sink.deliver(SourceId(u32::MAX), feed) {
                return;
            }
        }
    }
}
