//! A source for running nodes: at named addresses, or at all sockets of the socket folder, also those that appear later.

use super::session::{self, End, Pace, Talk};
use super::{Feed, Sink, Source, SourceId, Wishes};
use crate::error::MonitorError;
use crate::options::Endpoint;
use imrs_wire::obs::{NodeIdentity, Places, Token, place};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How often the socket folder is scanned.
const SCAN: Duration = Duration::from_millis(250);
/// The first and the longest pause before another attempt to connect.
const PAUSE: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(4));
/// How often a waiting thread checks whether it must stop.
const LOOK: Duration = Duration::from_millis(50);

/// The greatest number of addresses to which the monitor connects because a node reported them.
const MOST_FOLLOWED: usize = 64;

/// The nodes to attach to.
#[derive(Clone, Debug)]
pub enum Which {
    /// The nodes at these addresses, and the other nodes of their cells that they report. The monitor repeats its
    /// attempts for ever.
    Named(Vec<Endpoint>),
    /// The nodes of all sockets under this folder, also of those that appear later. The monitor gives a node up when
    /// its socket is gone.
    Under(PathBuf),
}

/// A source for running nodes. Dropping it ends its threads.
#[derive(Debug)]
pub struct Live {
    which: Which,
    pace: Pace,
    wishes: Wishes,
    token: Option<Arc<Token>>,
    stop: Arc<AtomicBool>,
    started: Arc<AtomicUsize>,
    /// The number that this source gives to its first connection.
    first: u32,
}

impl Live {
    /// Makes a source that will attach to the nodes of `which`.
    #[must_use]
    pub fn new(which: Which) -> Self {
        let pace = Pace { period: Duration::from_millis(100) };
        let stop = Arc::new(AtomicBool::new(false));
        Self { which, pace, wishes: Wishes::default(), token: None, stop, started: Arc::default(), first: 0 }
    }

    /// Sets the token for nodes that require one.
    #[must_use]
    pub fn with_token(mut self, token: Option<Token>) -> Self {
        self.token = token.map(Arc::new);
        self
    }

    /// Sets the subscription ([`Wishes`]) that this source passes to the nodes.
    #[must_use]
    pub fn with_wishes(mut self, wishes: &Wishes) -> Self {
        self.wishes = wishes.clone();
        self
    }

    /// The subscription that this source passes to the nodes.
    #[must_use]
    pub const fn wishes(&self) -> &Wishes {
        &self.wishes
    }

    /// Sets the number of the first connection, if lower numbers are already in use.
    #[must_use]
    pub const fn numbered_from(mut self, first: u32) -> Self {
        self.first = first;
        self
    }

    /// To how many nodes this source has tried to attach so far. Each attempt succeeds or fails later.
    #[must_use]
    pub fn started(&self) -> usize {
        self.started.load(Ordering::Relaxed)
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Source for Live {
    fn start(&mut self, sink: Sink) -> Result<(), MonitorError> {
        let crew = Crew {
            sink,
            pace: self.pace,
            wishes: self.wishes.clone(),
            token: self.token.clone(),
            stop: self.stop.clone(),
            next: Arc::new(AtomicU32::new(self.first)),
            known: Arc::default(),
            started: Arc::clone(&self.started),
        };
        match self.which.clone() {
            Which::Named(endpoints) => {
                self.started.store(endpoints.len(), Ordering::Relaxed);
                for endpoint in endpoints {
                    let _ = crew.attend(endpoint, false);
                }
            }
            Which::Under(base) => {
                let first = place::sockets_in(&base)?;
                self.started.store(first.len(), Ordering::Relaxed);
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
    pace: Pace,
    wishes: Wishes,
    token: Option<Arc<Token>>,
    stop: Arc<AtomicBool>,
    next: Arc<AtomicU32>,
    known: Arc<Mutex<Known>>,
    started: Arc<AtomicUsize>,
}

/// The known nodes and addresses, so that the monitor attaches to no node twice.
#[derive(Default)]
struct Known {
    /// The nodes with a connection thread, as names of cells and ids of nodes.
    nodes: HashSet<(String, u16)>,
    /// The addresses that nodes reported. The monitor connects to each of them once.
    followed: HashSet<Endpoint>,
}

impl Crew {
    /// Scans the folder repeatedly, until this source must stop.
    fn scan(&self, base: &Path, mut attended: HashMap<PathBuf, JoinHandle<()>>) {
        while !self.pause(SCAN) {
            attended.retain(|_, thread| !thread.is_finished());
            // A folder that cannot be read now may be readable at the next scan.
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

    /// Starts a thread that stays connected to `endpoint`. Returns `None` if no thread can be started; the next scan tries again.
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
            let with = Talk {
                id,
                pace: self.pace,
                wishes: &self.wishes,
                token: self.token.as_deref(),
                sink: &self.sink,
                stop: &self.stop,
                told: &|identity, places| self.follow(endpoint, identity, places, found),
            };
            let wanted = match session::run(endpoint, &with) {
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

    /// Connects to the addresses that a node reports for the other nodes of its cell, so that one address leads to all
    /// nodes of the cell. Unix sockets are skipped if the whole folder is scanned anyway.
    fn follow(&self, from: &Endpoint, identity: &NodeIdentity, places: &Places, found: bool) {
        let mut new = Vec::new();
        {
            let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
            known.nodes.insert((identity.cell.clone(), identity.id));
            for place in places.nodes.iter().take(MOST_FOLLOWED) {
                let Some(endpoint) = seen_from(from, &place.address) else { continue };
                let elsewhere = !found || matches!(endpoint, Endpoint::Tcp(_));
                let full = known.followed.len() >= MOST_FOLLOWED;
                if elsewhere
                    && !full
                    && endpoint != *from
                    && known.nodes.insert((identity.cell.clone(), place.node.0))
                    && known.followed.insert(endpoint.clone())
                {
                    new.push(endpoint);
                }
            }
        }
        for endpoint in new {
            if self.attend(endpoint, false).is_some() {
                self.started.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Waits. Returns true if this source must stop.
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

/// Converts an address that a node reported to one that this monitor can reach. For an unspecified or loopback address,
/// the host is the one at which the monitor reached the reporting node.
fn seen_from(from: &Endpoint, told: &str) -> Option<Endpoint> {
    let endpoint: Endpoint = told.parse().ok()?;
    let Endpoint::Tcp(address) = &endpoint else {
        // A Unix socket is reachable only on the same machine.
        return matches!(from, Endpoint::Unix(_)).then_some(endpoint);
    };
    let (Endpoint::Tcp(from), Ok(address)) = (from, address.parse::<SocketAddr>()) else {
        return Some(endpoint);
    };
    if !address.ip().is_unspecified() && !address.ip().is_loopback() {
        return Some(endpoint);
    }
    let (host, _) = from.rsplit_once(':')?;
    Some(Endpoint::Tcp(format!("{host}:{}", address.port())))
}

/// Removes a socket that no running process serves.
fn clear_away(path: &Path) -> Option<Feed> {
    let cell = path.parent()?.file_name()?.to_str()?.to_owned();
    let node = place::node_of(path)?.to_owned();
    place::remove_if_stale(path).then_some(Feed::Stale { cell, node })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_meant_on_the_machine_that_told_it() {
        let seen = |from: &str, told: &str| {
            seen_from(&from.parse().unwrap(), told).map(|endpoint| endpoint.to_string())
        };
        assert_eq!(seen("tcp:robot:7100", "tcp:0.0.0.0:7101").unwrap(), "tcp:robot:7101");
        assert_eq!(seen("tcp:robot:7100", "tcp:127.0.0.1:7101").unwrap(), "tcp:robot:7101");
        assert_eq!(seen("tcp:robot:7100", "tcp:10.0.0.7:7101").unwrap(), "tcp:10.0.0.7:7101");
        assert_eq!(seen("unix:/r/c/a-1.sock", "unix:/r/c/b-2.sock").unwrap(), "unix:/r/c/b-2.sock");
        assert_eq!(seen("tcp:robot:7100", "unix:/r/c/b-2.sock"), None);
        assert_eq!(seen("tcp:robot:7100", "nonsense"), None);
    }
}
