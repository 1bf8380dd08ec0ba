//! Whether this machine keeps a node from telling monitors anything: the thread that serves them comes after all others
//! (nice 19), and on a machine that is busy enough it gets no processor for a second and more.

use crate::support::stub::Beat;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What the kernel calls that thread.
const NAME: &str = "imrs observer";
/// How far back is looked.
const LATELY: Duration = Duration::from_secs(3);
/// Who has waited so long of that for a processor was kept from speaking.
const LONG: Duration = Duration::from_millis(250);

/// What keeps nodes from speaking.
#[derive(Default)]
pub struct Starved {
    /// By node: its thread, and how long that had waited for a processor, at several instants.
    threads: BTreeMap<String, Thread>,
    /// Of a node that is none.
    pub stub: Option<Beat>,
    /// When the last sample came, and when one came late: then all of the machine stood still.
    sampled: Option<Instant>,
    stood_still: Option<Instant>,
}

#[derive(Default)]
struct Thread {
    folder: PathBuf,
    waited: VecDeque<(Instant, Duration)>,
}

impl Starved {
    /// Takes down how long the nodes of a sample have waited, and when it came.
    pub fn look(&mut self, at: Instant, sample: &Value) {
        if self.sampled.replace(at).is_some_and(|before| at > before + 2 * LONG) {
            self.stood_still = Some(at);
        }
        for node in sample["nodes"].as_array().into_iter().flatten() {
            let (Some(name), Some(pid)) = (node["name"].as_str(), node["pid"].as_u64()) else { continue };
            let process = PathBuf::from(format!("/proc/{pid}/task"));
            let thread = self.threads.entry(name.to_owned()).or_default();
            if !thread.folder.starts_with(&process) {
                *thread = Thread { folder: named(&process).unwrap_or_default(), ..Thread::default() };
            }
            let now = Instant::now();
            if thread.waited.is_empty() {
                // It may have waited before it was seen for the first time.
                thread.waited.push_back((now, Duration::ZERO));
            }
            thread.waited.extend(waited(&thread.folder).map(|waited| (now, waited)));
            while thread.waited.front().is_some_and(|(at, _)| *at + LATELY < now) {
                thread.waited.pop_front();
            }
        }
    }

    /// Whether this node waits for a processor, or has waited long of late.
    pub fn now(&self, node: &Value) -> bool {
        let is_late = self.stub.as_ref().is_some_and(|beat| beat.was_late(LATELY));
        let waits = |name| self.lately(name) || self.threads.get(name).is_some_and(Thread::waits);
        let stood_still = self.stood_still.is_some_and(|at| at.elapsed() < LATELY);
        is_late || stood_still || node.as_str().is_some_and(waits)
    }

    /// Whether it has waited long of late.
    pub fn lately(&self, node: &str) -> bool {
        let waited =
            self.threads.get(node).and_then(|thread| Some((thread.waited.front()?, thread.waited.back()?)));
        waited.is_some_and(|((_, before), (_, after))| *after - *before >= LONG)
    }
}

impl Thread {
    /// Ready to run, and perhaps running.
    fn waits(&self) -> bool {
        let stat = std::fs::read_to_string(self.folder.join("stat")).unwrap_or_default();
        stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('R'))
    }
}

/// The folder of the thread of that name.
fn named(process: &Path) -> Option<PathBuf> {
    let threads = std::fs::read_dir(process).ok()?.flatten().map(|entry| entry.path());
    let mut threads = threads.filter(|thread| {
        std::fs::read_to_string(thread.join("comm")).is_ok_and(|name| name.trim_end() == NAME)
    });
    threads.next()
}

/// How long a thread has been ready to run without running: the second number, in nanoseconds.
fn waited(thread: &Path) -> Option<Duration> {
    let text = std::fs::read_to_string(thread.join("schedstat")).ok()?;
    text.split_whitespace().nth(1)?.parse().ok().map(Duration::from_nanos)
}
