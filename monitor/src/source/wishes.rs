//! What the screen needs of the nodes: handed from the thread that draws to those that talk, without waiting.

use imrs_protocol::{NodeId, PortId, TaskId};
use imrs_wire::obs::EventFilter;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What is wanted of every node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The ports whose queues are looked at, in the cell shown: with what each message has been through.
    pub watched: Vec<(NodeId, TaskId, PortId)>,
    /// The cell that they are of; `None`: of any.
    pub cell: Option<String>,
    /// How many waiting messages of each other port are wanted; at most 64 are told.
    pub queue_limit: u8,
    /// Which events.
    pub events: Option<EventFilter>,
}

impl Default for Wanted {
    fn default() -> Self {
        Self { watched: Vec::new(), cell: None, queue_limit: 64, events: Some(EventFilter::ALL) }
    }
}

/// The wishes of one monitor, shared by who has them and who passes them on.
#[derive(Clone, Debug, Default)]
pub struct Wishes(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    wanted: Mutex<Wanted>,
    /// Changes with `wanted`.
    version: AtomicU64,
    /// Changes with each wish for whole snapshots.
    whole: AtomicU64,
}

impl Wishes {
    /// From now on this is wanted.
    pub fn want(&self, wanted: Wanted) {
        let mut now = self.wanted();
        if *now != wanted {
            *now = wanted;
            self.0.version.fetch_add(1, Ordering::Release);
        }
    }

    /// A whole snapshot is wanted of every node.
    pub fn want_whole(&self) {
        self.0.whole.fetch_add(1, Ordering::Release);
    }

    /// What is wanted, and its version.
    pub(super) fn present(&self) -> (Wanted, u64) {
        let wanted = self.wanted();
        (wanted.clone(), self.version())
    }

    pub(super) fn version(&self) -> u64 {
        self.0.version.load(Ordering::Acquire)
    }

    pub(super) fn whole(&self) -> u64 {
        self.0.whole.load(Ordering::Acquire)
    }

    fn wanted(&self) -> MutexGuard<'_, Wanted> {
        self.0.wanted.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
