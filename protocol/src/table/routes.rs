//! The a priori routes between the nodes of a cell (§5.2.3).

use crate::cell::{Cell, CellError};
use crate::ids::NodeId;
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::format;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Links and nodes that routes avoid, because they have failed (D184). They stay declared: a task that can be reached only
/// through them keeps its route through them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Avoid {
    /// Links, each named by its two ends in either order. Parallel links are avoided together.
    pub links: Vec<(NodeId, NodeId)>,
    /// Nodes that relay no packets. Routes still begin and end there.
    pub relays: Vec<NodeId>,
}

impl Avoid {
    pub(super) fn check(&self, cell: &Cell, errors: &mut Vec<CellError>) {
        let is_linked =
            |a: NodeId, b: NodeId| cell.links.iter().any(|l| [(a, b), (b, a)].contains(&(l.a, l.b)));
        for &(a, b) in self.links.iter().filter(|&&(a, b)| !is_linked(a, b)) {
            errors.push(CellError::Dangling(format!("avoided link {a}--{b}")));
        }
        for node in self.relays.iter().filter(|node| node.index() >= cell.nodes.len()) {
            errors.push(CellError::Dangling(format!("avoided relay {node}")));
        }
    }

    fn avoids(&self, a: NodeId, b: NodeId) -> bool {
        self.links.iter().any(|&link| link == (a, b) || link == (b, a))
    }
}

/// A route from one node to another: its next node and its cost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hop {
    pub next: NodeId,
    /// The summed bounds of the route's links.
    pub bound: Ticks,
    pub(super) links: u8,
    /// How many avoided links and relays are on the route.
    avoided: u16,
}

impl Hop {
    const fn cost(self) -> (u16, Ticks, u8, NodeId) {
        (self.avoided, self.bound, self.links, self.next)
    }
}

/// For each (from, to), row-major, the best route: the one with the fewest avoided parts, then with the least summed link
/// bound, then with the fewest links, then with the lower next node. This is a total order, so every node computes the same
/// table (§5.2.3: static routing, established a priori). Each part of a route is the route between the ends of that part,
/// so the nodes on a route agree.
pub(super) fn shortest(cell: &Cell, avoid: &Avoid) -> Box<[Option<Hop>]> {
    let n = cell.nodes.len();
    let mut routes: Vec<Option<Hop>> = vec![None; n * n];
    let better = |new: Hop, old: Option<Hop>| old.is_none_or(|old| new.cost() < old.cost());
    for link in &cell.links {
        let avoided = u16::from(avoid.avoids(link.a, link.b));
        for (a, b) in [(link.a, link.b), (link.b, link.a)] {
            let hop = Hop { next: b, bound: link.delay, links: 1, avoided };
            let slot = &mut routes[a.index() * n + b.index()];
            if better(hop, *slot) {
                *slot = Some(hop);
            }
        }
    }
    for via in 0..n {
        let relay = u16::from(avoid.relays.contains(&NodeId::from_index(via)));
        for from in 0..n {
            for to in 0..n {
                let (Some(first), Some(second)) = (routes[from * n + via], routes[via * n + to]) else {
                    continue;
                };
                let hop = Hop {
                    next: first.next,
                    bound: first.bound + second.bound,
                    links: first.links.saturating_add(second.links),
                    avoided: first.avoided.saturating_add(second.avoided).saturating_add(relay),
                };
                if from != to && better(hop, routes[from * n + to]) {
                    routes[from * n + to] = Some(hop);
                }
            }
        }
    }
    routes.into_boxed_slice()
}
