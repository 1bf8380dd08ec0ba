//! Derives from the recordings of a run how its links and clocks behaved, so that this can be compared with the assumptions
//! of the checks.
//!
//! Two packets count as equal if they differ only in fields that change with time or in relays. An arrival of one of
//! several equal packets is matched with the last of them that was sent before it.

use imrs_model::cell::{Happened, Happening};
use imrs_protocol::{CellTable, Kind, NodeId, Packet, Ticks};
use std::collections::{BTreeMap, HashMap};

/// A packet that was sent this shortly before the end of the run may still be in flight, in microseconds. A packet that
/// was sent earlier and never arrived was lost.
const SETTLES: u64 = 500_000;

/// What happened to the packets from one node to another.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinkHistory {
    /// When the packets were sent that never arrived, in microseconds of the run's clock.
    pub lost: Vec<u64>,
    /// When copies arrived of packets that had arrived before.
    pub copies: Vec<u64>,
    /// For each packet that took longer than the bound: when it arrived, and how long it took.
    pub slow: Vec<(u64, u64)>,
    /// The longest time that a packet may take, in microseconds.
    pub bound: u64,
    /// The least time that a packet took, by the clocks of the two nodes. It is negative if the receiver's clock is behind.
    least: Option<i64>,
}

/// How links and clocks behaved in a run.
#[derive(Debug)]
pub struct Surroundings {
    /// The history of the packets, by sending and receiving node.
    pub links: BTreeMap<(NodeId, NodeId), LinkHistory>,
    /// Pairs of nodes whose clocks ran at different rates, and a lower bound of the difference in microseconds.
    pub drift: Vec<(NodeId, NodeId, u64)>,
    /// When actions failed, in microseconds.
    pub failed: Vec<u64>,
    /// Nodes whose recordings have no end, and the time of the last record of each.
    pub ended: Vec<(NodeId, u64)>,
}

/// A set of equal packets.
#[derive(Default)]
struct Alike {
    /// When each packet of the set was sent, and whether it can have arrived in time.
    sent: Vec<(u64, bool)>,
    came: Vec<u64>,
}

impl Surroundings {
    /// Derives the history from the events of each task. `whole` says for each node whether its recording has its end.
    pub fn of(tasks: &[Vec<Happening>], whole: &[bool], table: &CellTable) -> Self {
        let known = |node: usize| {
            let here = table.tasks_on(NodeId::from_index(node)).filter_map(|task| tasks.get(task.index()));
            here.flatten().map(|happening| happening.at).max().unwrap_or(0)
        };
        let ends: Vec<u64> = (0..whole.len()).map(known).collect();
        let failed = tasks.iter().flatten().filter(|one| matches!(one.what, Happened::Acted(_, false, _)));
        let mut links: BTreeMap<(NodeId, NodeId), LinkHistory> = BTreeMap::new();
        for ((from, to), alike) in packets(tasks, table) {
            let bound = table.path_bound(from, to).map_or(u64::MAX, |bound| bound.0);
            let link =
                links.entry((from, to)).or_insert_with(|| LinkHistory { bound, ..LinkHistory::default() });
            alike.judge(link, whole[from.index()]);
        }
        for ((_, to), link) in &mut links {
            // A killed node receives nothing more, and packets that were sent just before the end may still be in flight.
            let settled = if whole[to.index()] { SETTLES } else { SETTLES.max(link.bound) };
            let over = ends[to.index()].saturating_sub(settled);
            link.lost.retain(|sent| *sent < over);
            [&mut link.lost, &mut link.copies].into_iter().for_each(|times| times.sort_unstable());
            link.slow.sort_unstable();
        }
        let ended = (0..whole.len()).filter(|&node| !whole[node]);
        let ended = ended.map(|node| (NodeId::from_index(node), ends[node])).collect();
        Self { drift: drift(&links), links, failed: failed.map(|one| one.at).collect(), ended }
    }
}

/// The packet without the fields that change with time or in relays, so that equal packets can be found.
pub fn named(packet: &Packet) -> Packet {
    Packet { remaining: Ticks::ZERO, hops: 0, ..*packet }
}

/// The packets between nodes, without those by which a stopping node withdraws its tasks from their waits.
fn packets(tasks: &[Vec<Happening>], table: &CellTable) -> Vec<((NodeId, NodeId), Alike)> {
    let mut all: HashMap<Packet, Alike> = HashMap::new();
    let mut unsent = Vec::new();
    for task in tasks {
        let runs = task.iter().take_while(|happening| happening.what != Happened::Stopped);
        for Happening { at, what, task } in runs {
            match what {
                Happened::Unsent(id) => unsent.push((*task, *id, *at)),
                Happened::Sent(packet) => {
                    let ends = [packet.source, packet.destination].map(|task| table.location(task));
                    let bound = ends[0].zip(ends[1]).and_then(|(from, to)| table.path_bound(from, to));
                    // A packet that cannot arrive in time never leaves the node (D83).
                    let arrives = bound.is_some_and(|bound| bound < packet.remaining);
                    all.entry(named(packet)).or_default().sent.push((*at, arrives));
                }
                Happened::Came(packet) => all.entry(named(packet)).or_default().came.push(*at),
                _ => {}
            }
        }
    }
    for (task, id, at) in unsent {
        let of_it = all.iter_mut().filter(|(packet, _)| {
            packet.source == task && packet.id == id && matches!(packet.kind, Kind::Send | Kind::Query)
        });
        // The link did not lose a packet that never left its node.
        let sent =
            of_it.flat_map(|(_, alike)| &mut alike.sent).filter(|(sent, leaves)| *leaves && *sent <= at);
        sent.max_by_key(|(sent, _)| *sent).into_iter().for_each(|(_, leaves)| *leaves = false);
    }
    let between = |(packet, alike): (Packet, Alike)| {
        let ends = table.location(packet.source).zip(table.location(packet.destination));
        ends.filter(|(from, to)| from != to).map(|ends| (ends, alike))
    };
    all.into_iter().filter_map(between).collect()
}

impl Alike {
    /// Matches arrivals with sent packets, and adds the result to `link`.
    fn judge(mut self, link: &mut LinkHistory, sender_is_whole: bool) {
        self.sent.sort_unstable();
        self.came.sort_unstable();
        let all = self.sent.len();
        for came in self.came {
            let before = self.sent.partition_point(|(sent, _)| *sent <= came);
            // If the receiver's clock is behind the sender's, a packet seems to arrive before it was sent.
            let Some(at) = before.checked_sub(1).or_else(|| (!self.sent.is_empty()).then_some(0)) else {
                // A killed node may have sent the packet without recording it, so the packet does not count as a copy.
                if all > 0 && sender_is_whole {
                    link.copies.push(came);
                }
                continue;
            };
            let (sent, _) = self.sent.remove(at);
            let took = came.cast_signed() - sent.cast_signed();
            link.least = Some(link.least.map_or(took, |least| least.min(took)));
            if took > link.bound.cast_signed() {
                link.slow.push((came, took.unsigned_abs()));
            }
        }
        link.lost.extend(self.sent.iter().filter(|(_, arrives)| *arrives).map(|(at, _)| *at));
    }
}

/// For each two nodes, a lower bound of how far their clocks drifted apart. Every packet takes some time, so packets of
/// the two directions bound the difference of the clocks from both sides. If no single difference fits all packets, the
/// clocks ran at different rates.
fn drift(links: &BTreeMap<(NodeId, NodeId), LinkHistory>) -> Vec<(NodeId, NodeId, u64)> {
    let pairs = links.iter().filter(|((from, to), _)| from < to);
    let apart = pairs.filter_map(|((from, to), there)| {
        let there_and_back = there.least? + links.get(&(*to, *from))?.least?;
        (there_and_back < 0).then_some((*from, *to, there_and_back.unsigned_abs()))
    });
    apart.collect()
}
