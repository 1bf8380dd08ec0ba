//! The link between nodes of one process: packets are handed over as values, never serialised.
//!
//! Several nodes in one process serve tests and demonstrations. A [`Network`] can lose, repeat and delay packets at
//! random, from a seed.

use super::{Link, LinkBusy, LinkDiscard, PollEnd, Sink};
use crate::clock;
use crate::lock::lock;
use imrs_protocol::{CellTable, Incarnation, NodeId, Packet, Ticks};
use imrs_wire::envelope::MAX_PACKETS;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How many packets can wait for one node. If this many wait, its neighbours cannot send to it.
const CAPACITY: usize = 1024;
/// How many packets are taken from the network under one lock.
const AT_ONCE: usize = MAX_PACKETS;

/// The faults that the network injects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// The seed of the random draws.
    pub seed: u64,
    /// The share of packets that get lost, 0 to 1.
    pub loss: f64,
    /// The share of packets that arrive twice, 0 to 1.
    pub duplicates: f64,
    /// The shortest time that a packet takes.
    pub least_delay: Duration,
    /// The longest time that a packet takes. Packets that take different times overtake each other.
    pub most_delay: Duration,
}

/// The network that joins the nodes of one process.
pub struct Network {
    table: Arc<CellTable>,
    faults: Faults,
    ends: Box<[End]>,
}

/// The receiving end of one node.
struct End {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    /// The packets in flight to this node. The packet that arrives first is at the top.
    flights: BinaryHeap<Reverse<Flight>>,
    departures: u64,
    /// The incarnation of the node at this end; `None` while there is no node.
    start: Option<Start>,
    /// For each other node, the incarnation of it that this node last received packets from.
    heard: Vec<Option<Incarnation>>,
    /// Reusable storage for packets that have arrived. The polling thread takes this storage while it works.
    landed: Vec<Landed>,
    /// Whether a neighbour could not send to this node because too many packets waited.
    starved: bool,
    /// Whether this node takes packets again after too many waited, so that its neighbours must be notified.
    ready: bool,
    woken: bool,
    draws: fastrand::Rng,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Start {
    incarnation: Incarnation,
    restarted: bool,
}

#[derive(Clone, Copy, Debug)]
struct Flight {
    due: Instant,
    number: u64,
    left: Instant,
    from: NodeId,
    start: Start,
    packet: Packet,
}

/// A packet that has arrived, and whether its receiver knew the sending incarnation before.
#[derive(Clone, Copy, Debug)]
struct Landed {
    flight: Flight,
    known: bool,
}

impl Flight {
    /// Whether both packets left the same node at the same time.
    fn left_with(&self, other: &Self) -> bool {
        (self.from, self.start, self.left) == (other.from, other.start, other.left)
    }
}

impl PartialEq for Flight {
    fn eq(&self, other: &Self) -> bool {
        (self.due, self.number) == (other.due, other.number)
    }
}

impl Eq for Flight {}

impl PartialOrd for Flight {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Flight {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.due, self.number).cmp(&(other.due, other.number))
    }
}

impl Network {
    /// A network for all nodes of a cell.
    #[must_use]
    pub fn new(table: Arc<CellTable>, faults: Faults) -> Arc<Self> {
        let nodes = table.cell().nodes.len();
        let end = |node: usize| End {
            state: Mutex::new(State {
                flights: BinaryHeap::with_capacity(CAPACITY),
                departures: 0,
                start: None,
                heard: vec![None; nodes],
                landed: Vec::with_capacity(AT_ONCE),
                starved: false,
                ready: false,
                woken: false,
                draws: fastrand::Rng::with_seed(faults.seed.wrapping_add(node as u64)),
            }),
            changed: Condvar::new(),
        };
        Arc::new(Self { faults, ends: (0..nodes).map(end).collect(), table })
    }

    /// Returns the link of `node` in this incarnation. Packets in flight to an earlier incarnation of the node are lost.
    ///
    /// # Panics
    /// If the cell has no such node.
    #[must_use]
    pub fn join(self: &Arc<Self>, node: NodeId, incarnation: Incarnation, restarted: bool) -> InProcess {
        let mut state = self.ends[node.index()].lock();
        let start = Start { incarnation, restarted };
        state.flights.clear();
        state.start = Some(start);
        state.heard.fill(None);
        (state.ready, state.woken) = (false, false);
        InProcess { network: Arc::clone(self), node, start }
    }

    fn bound(&self, a: NodeId, b: NodeId) -> Duration {
        Duration::from_micros(self.table.link_bound(a, b).unwrap_or(Ticks::ZERO).0)
    }
}

impl End {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

impl State {
    /// Puts a packet in flight, unless the packet gets lost. Its remaining time was true at the instant `left`.
    fn depart(&mut self, faults: &Faults, left: Instant, from: NodeId, start: Start, packet: Packet) {
        if self.draws.f64() < faults.loss {
            return;
        }
        let copies = if self.draws.f64() < faults.duplicates { 2 } else { 1 };
        for _ in 0..copies {
            let spread = faults.most_delay.saturating_sub(faults.least_delay);
            let delay = faults.least_delay + spread.mul_f64(self.draws.f64());
            let (due, number) = (left + delay, self.departures);
            self.departures += 1;
            self.flights.push(Reverse(Flight { due, number, left, from, start, packet }));
        }
    }
}

/// The end of one node in a [`Network`]: its link.
pub struct InProcess {
    network: Arc<Network>,
    node: NodeId,
    start: Start,
}

impl InProcess {
    fn own(&self) -> &End {
        &self.network.ends[self.node.index()]
    }

    fn end(&self, node: NodeId) -> Option<&End> {
        self.network.table.link_bound(self.node, node)?;
        self.network.ends.get(node.index())
    }

    /// Hands packets that left one node together to the sink of the receiving node.
    fn land(&self, together: &[Landed], sink: &dyn Sink) {
        let Some(&Landed { flight: Flight { from, start, left, .. }, known }) = together.first() else {
            return;
        };
        // Packets of a node that has ended still count. If the node runs again, packets of its earlier incarnation do
        // not.
        let now_there = self.network.ends[from.index()].lock().start;
        if now_there.is_some_and(|now_there| now_there != start) {
            return together.iter().for_each(|_| sink.discarded(LinkDiscard::StaleIncarnation));
        }
        if !known {
            sink.peer(from, start.incarnation, start.restarted);
        }
        let mut packets = [together[0].flight.packet; AT_ONCE];
        packets.iter_mut().zip(together).for_each(|(packet, landed)| *packet = landed.flight.packet);
        // The charge is the larger of two times: the link's declared delay, and the time that the packets took (D20).
        let now = Instant::now();
        let took = now.saturating_duration_since(left);
        let charge = clock::micros(took.max(self.network.bound(from, self.node)));
        sink.packets(from, &packets[..together.len()], Ticks(charge), now);
    }

    fn tell_neighbours(&self) {
        for neighbour in self.network.table.neighbours(self.node) {
            if let Some(end) = self.end(neighbour) {
                end.lock().ready = true;
                end.changed.notify_all();
            }
        }
    }
}

impl Link for InProcess {
    fn ready(&self, next: NodeId) -> bool {
        let Some(end) = self.end(next) else { return false };
        let mut state = end.lock();
        let free = state.flights.len() < CAPACITY;
        state.starved |= !free;
        free
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        let end = self.end(next).ok_or(LinkBusy)?;
        let mut state = end.lock();
        if state.start.is_none() {
            // No node is at the other end. The packets are lost, as a datagram to a closed port is.
            return Ok(packets.len());
        }
        let free = CAPACITY.saturating_sub(state.flights.len());
        let taken = packets.len().min(free);
        if taken == 0 {
            state.starved = true;
            return Err(LinkBusy);
        }
        for packet in &packets[..taken] {
            state.depart(&self.network.faults, at, self.node, self.start, *packet);
        }
        drop(state);
        end.changed.notify_one();
        Ok(taken)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        let own = self.own();
        let mut state = own.lock();
        loop {
            if std::mem::take(&mut state.woken) {
                return PollEnd::Woken;
            }
            if std::mem::take(&mut state.ready) {
                return PollEnd::Ready;
            }
            let now = Instant::now();
            if state.flights.peek().is_some_and(|first| first.0.due <= now) {
                break;
            }
            if until.is_some_and(|until| until <= now) {
                return PollEnd::TimedOut;
            }
            let next = state.flights.peek().map(|first| first.0.due);
            let wake_at = next.into_iter().chain(until).min();
            clock::sleeps();
            state = match wake_at {
                None => own.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(at) => {
                    let waited = own.changed.wait_timeout(state, at.saturating_duration_since(now));
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
        let now = Instant::now();
        let mut landed = std::mem::take(&mut state.landed);
        while landed.len() < AT_ONCE && state.flights.peek().is_some_and(|first| first.0.due <= now) {
            let Some(Reverse(flight)) = state.flights.pop() else { break };
            let incarnation = flight.start.incarnation;
            let known = state.heard[flight.from.index()].replace(incarnation) == Some(incarnation);
            landed.push(Landed { flight, known });
        }
        let starved = std::mem::take(&mut state.starved);
        drop(state);
        if starved {
            self.tell_neighbours();
        }
        let with = |a: &Landed, b: &Landed| b.known && a.flight.left_with(&b.flight);
        landed.chunk_by(with).for_each(|together| self.land(together, sink));
        landed.clear();
        own.lock().landed = landed;
        PollEnd::Received
    }

    fn wake(&self) {
        self.own().lock().woken = true;
        self.own().changed.notify_all();
    }
}

/// The node is gone, so packets to it are lost from now on.
impl Drop for InProcess {
    fn drop(&mut self) {
        let mut state = self.own().lock();
        if state.start == Some(self.start) {
            state.start = None;
            state.flights.clear();
        }
    }
}
