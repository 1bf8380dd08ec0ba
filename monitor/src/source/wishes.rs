//! The subscription that the screen needs (its wishes). The drawing thread hands it to the connection threads without
//! waiting.

use imrs_protocol::{NodeId, PortId, TaskId};
use imrs_wire::obs::EventFilter;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A subscription for all nodes of a cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The watched ports of the shown cell. For these ports, the node sends the queues with the history of each message.
    pub watched: Vec<(NodeId, TaskId, PortId)>,
    /// The cell of the watched ports; `None` if any cell is meant.
    pub cell: Option<String>,
    /// How many queued messages the node lists of each other port; at most 64.
    pub queue_limit: u8,
    /// Which events the node sends; `None` for none.
    pub events: Option<EventFilter>,
}

impl Default for Wanted {
    fn default() -> Self {
        Self { watched: Vec::new(), cell: None, queue_limit: 64, events: Some(EventFilter::ALL) }
    }
}

/// The subscription of one monitor, shared by the drawing thread and the connection threads.
#[derive(Clone, Debug, Default)]
pub struct Wishes(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    wanted: Mutex<Wanted>,
    /// A number that changes whenever `wanted` changes.
    version: AtomicU64,
    /// A number that changes whenever whole snapshots are wanted.
    whole: AtomicU64,
}

impl Wishes {
    /// Sets the subscription.
    pub fn want(&self, wanted: Wanted) {
        let mut now = self.wanted();
        if *now != wanted {
            *now = wanted;
            self.0.version.fetch_add(1, Ordering::Release);
        }
    }

    /// Asks every node for a whole snapshot.
    pub fn want_whole(&self) {
        self.0.whole.fetch_add(1, Ordering::Release);
    }

    /// The subscription and its version.
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
