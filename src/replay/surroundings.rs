//! What links and clocks did in a run, as its recordings show it: the assumptions of a check are about these.
//!
//! Packets are told apart by all but what time and relays change. Of those that are alike each arrival belongs to the last
//! one that was sent before it.

use imrs_model::cell::{Happened, Happening};
use imrs_protocol::{CellTable, NodeId, Packet, Ticks};
use std::collections::{BTreeMap, HashMap};

/// Microseconds in which what is under way at the end of a run may still be: later than this it was lost.
const SETTLES: u64 = 500_000;

/// What happened on the way from one node to another.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Way {
    /// Microseconds of the run's clock at which packets were sent that never arrived.
    pub lost: Vec<u64>,
    /// At which packets arrived once more.
    pub copies: Vec<u64>,
    /// At which packets arrived that had taken longer than the bound, and how long.
    pub slow: Vec<(u64, u64)>,
    /// Microseconds that a packet may take.
    pub bound: u64,
    /// The least time by the clocks of the two nodes that a packet took: less than nothing where they differ.
    least: Option<i64>,
}

/// What links and clocks did.
#[derive(Debug)]
pub struct Surroundings {
    /// By the nodes that packets went from and to.
    pub ways: BTreeMap<(NodeId, NodeId), Way>,
    /// Pairs of nodes whose clocks ran apart, and by how many microseconds at least.
    pub drift: Vec<(NodeId, NodeId, u64)>,
    /// At which microseconds actions failed.
    pub failed: Vec<u64>,
    /// Nodes whose recordings have no end, and the last microsecond known of each.
    pub ended: Vec<(NodeId, u64)>,
}

/// All packets that are alike.
#[derive(Default)]
struct Alike {
    /// When, and whether they may be expected to arrive.
    sent: Vec<(u64, bool)>,
    came: Vec<u64>,
}

impl Surroundings {
    /// Of what each task did, by task; `whole` says of each node whether its recording has its end.
    pub fn of(tasks: &[Vec<Happening>], whole: &[bool], table: &CellTable) -> Self {
        let known = |node: usize| {
            let here = table.tasks_on(NodeId::from_index(node)).filter_map(|task| tasks.get(task.index()));
            here.flatten().map(|happening| happening.at).max().unwrap_or(0)
        };
        let ends: Vec<u64> = (0..whole.len()).map(known).collect();
        let failed = tasks.iter().flatten().filter(|one| matches!(one.what, Happened::Acted(_, false, _)));
        let mut ways: BTreeMap<(NodeId, NodeId), Way> = BTreeMap::new();
        for ((from, to), alike) in packets(tasks, table) {
            let bound = table.path_bound(from, to).map_or(u64::MAX, |bound| bound.0);
            let way = ways.entry((from, to)).or_insert_with(|| Way { bound, ..Way::default() });
            alike.judge(way, whole[from.index()]);
        }
        for ((_, to), way) in &mut ways {
            // A node that was killed hears nothing more; the last things before the end may be under way.
            let settled = if whole[to.index()] { SETTLES } else { SETTLES.max(way.bound) };
            let over = ends[to.index()].saturating_sub(settled);
            way.lost.retain(|sent| *sent < over);
            [&mut way.lost, &mut way.copies].into_iter().for_each(|times| times.sort_unstable());
            way.slow.sort_unstable();
        }
        let ended = (0..whole.len()).filter(|&node| !whole[node]);
        let ended = ended.map(|node| (NodeId::from_index(node), ends[node])).collect();
        Self { drift: drift(&ways), ways, failed: failed.map(|one| one.at).collect(), ended }
    }
}

/// Without what relays and time change.
pub fn named(packet: &Packet) -> Packet {
    Packet { remaining: Ticks::ZERO, hops: 0, ..*packet }
}

/// The packets between nodes. What a node takes back when it stops is none.
fn packets(tasks: &[Vec<Happening>], table: &CellTable) -> Vec<((NodeId, NodeId), Alike)> {
    let mut all: HashMap<Packet, Alike> = HashMap::new();
    for task in tasks {
        let runs = task.iter().take_while(|happening| happening.what != Happened::Stopped);
        for Happening { at, what, .. } in runs {
            match what {
                Happened::Sent(packet) => {
                    let ends = [packet.source, packet.destination].map(|task| table.location(task));
                    let bound = ends[0].zip(ends[1]).and_then(|(from, to)| table.path_bound(from, to));
                    // What cannot arrive in time is not sent (D83).
                    let arrives = bound.is_some_and(|bound| bound < packet.remaining);
                    all.entry(named(packet)).or_default().sent.push((*at, arrives));
                }
                Happened::Came(packet) => all.entry(named(packet)).or_default().came.push(*at),
                _ => {}
            }
        }
    }
    let between = |(packet, alike): (Packet, Alike)| {
        let ends = table.location(packet.source).zip(table.location(packet.destination));
        ends.filter(|(from, to)| from != to).map(|ends| (ends, alike))
    };
    all.into_iter().filter_map(between).collect()
}

impl Alike {
    /// Adds these packets to what is known of their way.
    fn judge(mut self, way: &mut Way, sender_is_whole: bool) {
        self.sent.sort_unstable();
        self.came.sort_unstable();
        let all = self.sent.len();
        for came in self.came {
            let before = self.sent.partition_point(|(sent, _)| *sent <= came);
            // One clock may be behind the other: then a packet arrives before it was sent.
            let Some(at) = before.checked_sub(1).or_else(|| (!self.sent.is_empty()).then_some(0)) else {
                // What was not recorded of a killed node is no copy.
                if all > 0 && sender_is_whole {
                    way.copies.push(came);
                }
                continue;
            };
            let (sent, _) = self.sent.remove(at);
            let took = came.cast_signed() - sent.cast_signed();
            way.least = Some(way.least.map_or(took, |least| least.min(took)));
            if took > way.bound.cast_signed() {
                way.slow.push((came, took.unsigned_abs()));
            }
        }
        way.lost.extend(self.sent.iter().filter(|(_, arrives)| *arrives).map(|(at, _)| *at));
    }
}

/// By how much the clocks of two nodes ran apart, at least. A packet takes some time, so the difference of two clocks lies
/// between what packets of the one direction took by them and what those of the other did; where that cannot be one and
/// the same difference all the time, the clocks ran at different rates.
fn drift(ways: &BTreeMap<(NodeId, NodeId), Way>) -> Vec<(NodeId, NodeId, u64)> {
    let pairs = ways.iter().filter(|((from, to), _)| from < to);
    let apart = pairs.filter_map(|((from, to), there)| {
        let there_and_back = there.least? + ways.get(&(*to, *from))?.least?;
        (there_and_back < 0).then_some((*from, *to, there_and_back.unsigned_abs()))
    });
    apart.collect()
}
