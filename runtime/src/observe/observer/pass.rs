//! What the observer reads from the node in one pass over its monitors. Monitors with the same subscription share it:
//! the node is read once and each frame is encoded once, however many monitors there are.

use super::Showing;
use crate::observe::batch::{Batch, Share};
use crate::observe::observations::Observations;
use crate::observe::snapshot::Watching;
use imrs_wire::obs::{
    Delta, EventFilter, Events, FrameError, Kinds, Places, ServerFrame, Snapshot, TimedEvent,
};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How many events of one state machine are put into one frame, at most.
const EVENT_ROOM: usize = 512;
/// How many events are put into one frame, at most.
const MAX_EVENTS: usize = 16_384;

pub(super) struct Pass {
    /// When the observer started. Periodic frames are due at whole periods after this instant, so that they are due
    /// for all monitors at once.
    started: Instant,
    pub now: Instant,
    places: Option<Places>,
    snapshots: Vec<(Watching, Arc<Snapshot>)>,
    changes: Vec<Change>,
    batches: Vec<(EventFilter, Batch, Arc<Vec<u8>>)>,
}

/// An encoded frame: what has changed between two snapshots.
struct Change {
    old: Option<Arc<Snapshot>>,
    new: Arc<Snapshot>,
    frame: Arc<Vec<u8>>,
}

impl Pass {
    pub fn new(now: Instant) -> Self {
        Self {
            started: now,
            now,
            places: None,
            snapshots: Vec::new(),
            changes: Vec::new(),
            batches: Vec::new(),
        }
    }

    /// Begins the next pass, and forgets what was read in the last one.
    pub fn begin(&mut self, now: Instant) {
        self.now = now;
        self.places = None;
        self.snapshots.clear();
        self.changes.clear();
        self.batches.clear();
    }

    /// The first instant after this pass that is a whole number of periods after the start.
    pub fn next(&self, period: Duration) -> Instant {
        let period = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX).max(1);
        let passed = u64::try_from(self.now.saturating_duration_since(self.started).as_nanos());
        let passed = passed.unwrap_or(u64::MAX);
        self.now + Duration::from_nanos(period - passed % period)
    }

    pub fn places(&mut self, showing: &Showing) -> &Places {
        self.places.get_or_insert_with(|| showing.places())
    }

    pub fn snapshot(&mut self, showing: &Showing, watching: &Watching) -> Arc<Snapshot> {
        if let Some((_, snapshot)) = self.snapshots.iter().find(|(of, _)| of == watching) {
            return Arc::clone(snapshot);
        }
        let snapshot = Arc::new(showing.node.snapshot_of(watching));
        self.snapshots.push((watching.clone(), Arc::clone(&snapshot)));
        snapshot
    }

    /// The frame about what has changed since the snapshot `old`, or about all of `new`.
    pub fn change(
        &mut self,
        old: Option<&Arc<Snapshot>>,
        new: &Arc<Snapshot>,
    ) -> Result<Arc<Vec<u8>>, FrameError> {
        let is_old = |known: &Change| match (&known.old, old) {
            (Some(known), Some(old)) => Arc::ptr_eq(known, old),
            (known, old) => known.is_none() && old.is_none(),
        };
        if let Some(known) = self.changes.iter().find(|known| Arc::ptr_eq(&known.new, new) && is_old(known)) {
            return Ok(Arc::clone(&known.frame));
        }
        let delta = old.map_or_else(|| Delta::whole(new), |old| Delta::between(old, new));
        let frame = Arc::new(ServerFrame::Delta(delta).encode()?);
        self.changes.push(Change { old: old.cloned(), new: Arc::clone(new), frame: Arc::clone(&frame) });
        Ok(frame)
    }

    /// The encoded frame with the events since this reader's last frame; empty if there were none.
    pub fn events(
        &mut self,
        filter: &EventFilter,
        observations: &mut Observations,
    ) -> Result<Arc<Vec<u8>>, FrameError> {
        for (of, batch, frame) in &self.batches {
            if of != filter {
                continue;
            }
            match observations.take(batch) {
                Some(Share::All) => return Ok(Arc::clone(frame)),
                Some(Share::Part(events, lost)) => return Ok(Arc::new(encoded(filter, events, lost)?)),
                None => {}
            }
        }
        let mut batch = observations.drain_batch(|task| filter.of(task), EVENT_ROOM);
        let events = std::mem::take(&mut batch.events);
        let frame = if filter.kinds == Kinds::ALL && (1..=MAX_EVENTS).contains(&events.len()) {
            // The events are not copied, because all of them are sent.
            let all = ServerFrame::Events(Events { lost: batch.lost(), events });
            let bytes = all.encode()?;
            if let ServerFrame::Events(all) = all {
                batch.events = all.events;
            }
            bytes
        } else {
            batch.events.clone_from(&events);
            encoded(filter, events, batch.lost())?
        };
        let frame = Arc::new(frame);
        self.batches.push((filter.clone(), batch, Arc::clone(&frame)));
        Ok(frame)
    }
}

/// The frame of the events that the filter selects; empty if there are none, and none were lost.
fn encoded(filter: &EventFilter, mut events: Vec<TimedEvent>, lost: u64) -> Result<Vec<u8>, FrameError> {
    events.retain(|event| filter.wants(event.task, event.what.event));
    let lost = lost + events.len().saturating_sub(MAX_EVENTS) as u64;
    events.truncate(MAX_EVENTS);
    if events.is_empty() && lost == 0 {
        return Ok(Vec::new());
    }
    ServerFrame::Events(Events { lost, events }).encode()
}
