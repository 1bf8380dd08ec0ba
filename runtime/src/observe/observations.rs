//! Readers of a node's observations, each with its own position in every ring.

use crate::node::Node;
use crate::observe::batch::{Batch, Run, Share};
use crate::observe::ring::Ring;
use imrs_protocol::{Observation, TaskId};
use imrs_wire::obs::TimedEvent;
use std::sync::Arc;

/// Follows the observations of a node. A reader that reads too seldom loses the oldest observations, and learns how many;
/// the node never waits.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Event, PortDecl, Ticks, Usage};
/// use imrs_runtime::Runtime;
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("news", Ticks(1_000));
/// let here = cell.node("here");
/// let (a, b) = (cell.task("a", here), cell.task("b", here));
/// cell.port(PortDecl::new("news", a, Usage::Send, &[b], Ticks(1_000_000)));
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
/// let node = Runtime::builder(table, here)
///     .task("a", |ctx| {
///         ctx.delay(Duration::from_millis(50))?;
///         let news = ctx.port("news")?;
///         ctx.send(news, b"part")?;
///         Ok(())
///     })
///     .task("b", |ctx| ctx.receive(None, None).map(drop))
///     .start()
///     .expect("a node that starts");
/// let mut observations = node.node().observe();
/// assert!(node.wait(Duration::from_secs(10)));
/// let mut events = Vec::new();
/// let lost = observations.drain(100, &mut events);
/// assert_eq!(lost, 0);
/// assert!(events.iter().any(|event| event.what.event == Event::Sent));
/// ```
pub struct Observations {
    node: Arc<Node>,
    /// For each state machine, the position from which to read on: in the order of the tasks, the transit buffer last.
    positions: Box<[u64]>,
}

impl Observations {
    pub(super) const fn new(node: Arc<Node>, positions: Box<[u64]>) -> Self {
        Self { node, positions }
    }

    /// Appends the observations since the last call to `events`, at most `room` of each state machine, oldest first for
    /// each. Returns how many observations were lost.
    pub fn drain(&mut self, room: usize, events: &mut Vec<TimedEvent>) -> u64 {
        self.drain_of(|_| true, room, events)
    }

    /// As [`drain`](Self::drain), for the state machines that `wanted` selects (`None` stands for the transit buffer).
    /// The observations of other state machines are skipped, and not counted as lost.
    pub fn drain_of(
        &mut self,
        wanted: impl Fn(Option<TaskId>) -> bool,
        room: usize,
        events: &mut Vec<TimedEvent>,
    ) -> u64 {
        let mut lost = 0;
        self.follow(wanted, room, events, |run| lost += run.lost());
        lost
    }

    /// As [`drain_of`](Self::drain_of), but also returns from where to where each ring was read. Readers at other
    /// positions can then share the result.
    pub(crate) fn drain_batch(&mut self, wanted: impl Fn(Option<TaskId>) -> bool, room: usize) -> Batch {
        let mut batch = Batch::default();
        let runs = &mut batch.runs;
        self.follow(wanted, room, &mut batch.events, |run| runs.push(run));
        batch
    }

    /// This reader's share of `batch`, as if the reader had read the rings itself; `None` if the batch begins after
    /// this reader's position or ends before it.
    pub(crate) fn take(&mut self, batch: &Batch) -> Option<Share> {
        let share = batch.share(&self.positions)?;
        for (position, run) in self.positions.iter_mut().zip(&batch.runs) {
            // This reader may already be further along a ring that it does not want.
            *position = run.end.max(*position);
        }
        Some(share)
    }

    fn follow(
        &mut self,
        wanted: impl Fn(Option<TaskId>) -> bool,
        room: usize,
        events: &mut Vec<TimedEvent>,
        mut each_run: impl FnMut(Run),
    ) {
        let Some((transit, tasks)) = self.positions.split_last_mut() else { return };
        let mut follow = |ring: &Ring, position: &mut u64, task: Option<TaskId>| {
            let from = *position;
            if !wanted(task) {
                (*position, _) = ring.read(from, usize::MAX, |_, _| {});
                return each_run(Run { from, begin: from, end: *position, wanted: false });
            }
            let each = |mono_us, what: Observation| events.push(TimedEvent { mono_us, task, what });
            let (end, gone) = ring.read(from, room, each);
            *position = end;
            each_run(Run { from, begin: from + gone, end, wanted: true });
        };
        for (local, position) in self.node.locals.list.iter().zip(tasks) {
            self.node.look(local, |comm| follow(comm.ring(), position, Some(local.task)));
        }
        self.node.dispatch.with_ring(|ring| follow(ring, transit, None));
    }
}

impl Drop for Observations {
    fn drop(&mut self) {
        for local in &self.node.locals.list {
            self.node.look(local, |comm| comm.ring().unsubscribe());
        }
        self.node.dispatch.with_ring(Ring::unsubscribe);
    }
}
