//! Running nodes: sockets that were named, or all that the socket folder has, also those that appear later.

use super::session::{self, End, Want};
use super::{Feed, Sink, Source, SourceId};
use crate::error::MonitorError;
use crate::options::Endpoint;
use imrs_wire::obs::place;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How often the socket folder is looked through.
const SCAN: Duration = Duration::from_millis(250);
/// The first and the longest pause before another attempt.
const PAUSE: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(4));
/// How long a pause may go on without looking whether to stop.
const LOOK: Duration = Duration::from_millis(50);

/// Which nodes.
#[derive(Clone, Debug)]
pub enum Which {
    /// These, and no others. They are tried again for ever.
    Named(Vec<Endpoint>),
    /// All whose sockets lie under this folder, now or later. A node is given up when its socket is gone.
    Under(PathBuf),
}

/// Running nodes. Dropping it ends its threads.
#[derive(Debug)]
pub struct Live {
    which: Which,
    want: Want,
    stop: Arc<AtomicBool>,
    started: usize,
}

impl Live {
    /// A source that will attach to `which`.
    #[must_use]
    pub fn new(which: Which) -> Self {
        let want = Want { period: Duration::from_millis(100), queue_limit: 64, events: true };
        Self { which, want, stop: Arc::new(AtomicBool::new(false)), started: 0 }
    }

    /// How many endpoints were there at the start: so many sources will attach or fail.
    #[must_use]
    pub const fn started(&self) -> usize {
        self.started
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Source for Live {
    fn start(&mut self, sink: Sink) -> Result<(), MonitorError> {
        let crew = Crew { sink, want: self.want, stop: self.stop.clone(), next: Arc::new(AtomicU32::new(0)) };
        match self.which.clone() {
            Which::Named(endpoints) => {
                self.started = endpoints.len();
                for endpoint in endpoints {
                    let _ = crew.attend(endpoint, false);
                }
            }
            Which::Under(base) => {
                let first = place::sockets_in(&base)?;
                self.started = first.len();
                let mut attended = HashMap::new();
                crew.attend_all(first, &mut attended);
                thread::Builder::new()
                    .name("imrs-scan".into())
                    .spawn(move || crew.scan(&base, attended))
                    .map_err(MonitorError::Terminal)?;
            }
        }
        Ok(())
    }
}

#[derive(Clone)]
struct Crew {
    sink: Sink,
    want: Want,
    stop: Arc<AtomicBool>,
    next: Arc<AtomicU32>,
}

impl Crew {
    /// Looks through the folder until told to stop.
    fn scan(&self, base: &Path, mut attended: HashMap<PathBuf, JoinHandle<()>>) {
        while !self.pause(SCAN) {
            attended.retain(|_, thread| !thread.is_finished());
            // A folder that cannot be read now may be readable again next time.
            let found = place::sockets_in(base).unwrap_or_default();
            self.attend_all(found, &mut attended);
        }
    }

    fn attend_all(&self, found: Vec<PathBuf>, attended: &mut HashMap<PathBuf, JoinHandle<()>>) {
        for path in found {
            if let Entry::Vacant(free) = attended.entry(path)
                && let Some(thread) = self.attend(Endpoint::Unix(free.key().clone()), true)
            {
                free.insert(thread);
            }
        }
    }

    /// A thread that stays with `endpoint`. `None` where the system has no thread to give: the next scan tries again.
    fn attend(&self, endpoint: Endpoint, found: bool) -> Option<JoinHandle<()>> {
        let id = SourceId(self.next.fetch_add(1, Ordering::Relaxed));
        let crew = self.clone();
        thread::Builder::new()
            .name("imrs-feed".into())
            .spawn(move || crew.stay_with(&endpoint, id, found))
            .ok()
    }

    fn stay_with(&self, endpoint: &Endpoint, id: SourceId, found: bool) {
        let mut pause = PAUSE.0;
        loop {
            let wanted = match session::run(endpoint, id, self.want, &self.sink, &self.stop) {
                End::Stopped => return,
                End::Lost(why) => {
                    pause = PAUSE.0;
                    self.sink.deliver(id, Feed::Lost { why })
                }
                End::Failed(why) => self.sink.deliver(id, Feed::Failed { why }),
                End::Refused(why) => match endpoint {
                    Endpoint::Unix(path) if found => {
                        if let Some(stale) = clear_away(path) {
                            let _ = self.sink.deliver(id, stale);
                            return;
                        }
                        self.sink.deliver(id, Feed::Failed { why })
                    }
                    Endpoint::Unix(_) | Endpoint::Tcp(_) => self.sink.deliver(id, Feed::Failed { why }),
                },
            };
            let left = matches!(endpoint, Endpoint::Unix(path) if found && !path.exists());
            if left {
                let _ = self.sink.deliver(id, Feed::Left);
            }
            if !wanted || left || self.pause(pause.mul_f64(0.75 + 0.5 * fastrand::f64())) {
                return;
            }
            pause = (pause * 2).min(PAUSE.1);
        }
    }

    /// Waits. `true`: stop.
    fn pause(&self, length: Duration) -> bool {
        let until = Instant::now() + length;
        while !self.stop.load(Ordering::Relaxed) {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            thread::sleep(left.min(LOOK));
        }
        true
    }
}

/// Removes a socket that nothing is behind any more.
fn clear_away(path: &Path) -> Option<Feed> {
    let cell = path.parent()?.file_name()?.to_str()?.to_owned();
    let node = place::node_of(path)?.to_owned();
    place::remove_if_stale(path).then_some(Feed::Stale { cell, node })
}
