//! Detects nodes that this machine keeps from reporting to monitors. The observer thread runs at nice 19, and on a busy machine
//! it may get no processor for a second or more.

use crate::support::stub::Beat;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The name of the observer thread.
const NAME: &str = "imrs observer";
/// The length of the past that `lately` considers.
const LATELY: Duration = Duration::from_secs(3);
/// A thread that waited this long for a processor within `LATELY` counts as unable to report.
const LONG: Duration = Duration::from_millis(250);

/// The waiting times of the nodes' observer threads.
#[derive(Default)]
pub struct Starved {
    /// For each node, the thread of its process that serves monitors.
    threads: BTreeMap<String, Thread>,
    /// The timing of a stub node.
    pub stub: Option<Beat>,
    /// When the last sample came, and when a sample last came late. A late sample means that the whole machine stood still.
    sampled: Option<Instant>,
    stood_still: Option<Instant>,
}

#[derive(Default)]
struct Thread {
    folder: PathBuf,
    waited: VecDeque<(Instant, Duration)>,
}

impl Starved {
    /// Records how long the nodes of a sample have waited, and when the sample came.
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
                // The thread may already have waited before its first sample.
                thread.waited.push_back((now, Duration::ZERO));
            }
            thread.waited.extend(waited(&thread.folder).map(|waited| (now, waited)));
            while thread.waited.front().is_some_and(|(at, _)| *at + LATELY < now) {
                thread.waited.pop_front();
            }
        }
    }

    /// Whether this node's observer thread waits for a processor now, or has recently waited for long.
    pub fn now(&self, node: &Value) -> bool {
        let is_late = self.stub.as_ref().is_some_and(|beat| beat.was_late(LATELY));
        let waits = |name| self.lately(name) || self.threads.get(name).is_some_and(Thread::waits);
        let stood_still = self.stood_still.is_some_and(|at| at.elapsed() < LATELY);
        is_late || stood_still || node.as_str().is_some_and(waits)
    }

    /// Whether this node's observer thread has recently waited for long.
    pub fn lately(&self, node: &str) -> bool {
        let waited =
            self.threads.get(node).and_then(|thread| Some((thread.waited.front()?, thread.waited.back()?)));
        waited.is_some_and(|((_, before), (_, after))| *after - *before >= LONG)
    }
}

impl Thread {
    /// Whether the thread is ready to run, or running.
    fn waits(&self) -> bool {
        let stat = std::fs::read_to_string(self.folder.join("stat")).unwrap_or_default();
        stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('R'))
    }
}

/// The `/proc` folder of the observer thread.
fn named(process: &Path) -> Option<PathBuf> {
    let threads = std::fs::read_dir(process).ok()?.flatten().map(|entry| entry.path());
    let mut threads = threads.filter(|thread| {
        std::fs::read_to_string(thread.join("comm")).is_ok_and(|name| name.trim_end() == NAME)
    });
    threads.next()
}

/// The total time for which a thread was ready but not running: the second number in `schedstat`, in nanoseconds.
fn waited(thread: &Path) -> Option<Duration> {
    let text = std::fs::read_to_string(thread.join("schedstat")).ok()?;
    text.split_whitespace().nth(1)?.parse().ok().map(Duration::from_nanos)
}
