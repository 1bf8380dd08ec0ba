//! The static table of a cell: ports, locations and a priori routes (§III, §5.2.2, §5.2.3). It is made from a [`Cell`] and
//! passed into every call. It is never part of a machine's state. The table of a running node may be replaced by one with
//! other routes ([`CellTable::around`], D184).

mod check;
mod couples;
mod digest;
mod ends;
mod node;
mod port;
mod replace;
mod restart;
mod routes;

pub use node::NodeTable;
pub(crate) use port::{Ends, Peer};
pub use port::{Party, Port};
pub use replace::TableError;
pub use routes::Avoid;
pub(crate) use routes::Hop;

use crate::cell::{Cell, CellError, PortDecl, TaskDecl, Usage, UserDecl};
use crate::ids::{NodeId, PortId, TaskId};
use crate::margin;
use crate::packet::MAX_HOPS;
use crate::rules::Rules;
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::collections::BTreeSet;
use alloc::vec;
use alloc::vec::Vec;

/// Everything about a cell that all its nodes know.
#[derive(Debug)]
pub struct CellTable {
    cell: Cell,
    ports: Box<[Port]>,
    digest: u32,
    epoch: u32,
    /// The links and nodes that the routes avoid.
    avoid: Avoid,
    /// For each pair of nodes (from, to), row by row: the next node of the route, and the sum of its links'
    /// bounds.
    routes: Box<[Option<Hop>]>,
    /// For each task, the ports it owns or uses, ascending.
    ports_of: Box<[Box<[PortId]>]>,
    /// The node of each task, and the position of the task among those of the node.
    locations: Box<[(NodeId, u16)]>,
    /// How long each task's script is held back after its node restarts.
    held_back: Box<[Ticks]>,
    /// Whether the cell runs the decided rules.
    decided: bool,
}

impl CellTable {
    /// Checks a cell and computes the table that its nodes need.
    ///
    /// # Errors
    /// Every fault that was found, in the order of the declarations.
    pub fn new(cell: Cell) -> Result<Self, Vec<CellError>> {
        Self::compile(cell, Avoid::default())
    }

    /// The table of the same cell at another epoch. Its routes avoid the links and nodes that `avoid` names, wherever the
    /// cell has another route. Positions and digest are those of this table, so nodes of both epochs talk to each other. A
    /// running node takes the table by [`Node::replace_table`](crate::Node::replace_table) if its epoch is later (D184).
    ///
    /// # Errors
    /// Each declared time that does not cover a longer route, and each node of `avoid` that the cell does not have.
    pub fn around(&self, epoch: u32, avoid: Avoid) -> Result<Self, Vec<CellError>> {
        let table = Self::compile(self.cell.clone(), avoid)?;
        Ok(Self { epoch, digest: self.digest, ..table })
    }

    fn compile(cell: Cell, avoid: Avoid) -> Result<Self, Vec<CellError>> {
        let mut errors = Vec::new();
        check::names(&cell, &mut errors);
        check::references(&cell, &mut errors);
        avoid.check(&cell, &mut errors);
        if !errors.is_empty() {
            return Err(errors);
        }
        let routes = routes::shortest(&cell, &avoid);
        let declared = cell.ports.iter().enumerate();
        let mut ports: Box<[Port]> =
            declared.map(|(i, decl)| compile_port(&cell, PortId::from_index(i), decl, &routes)).collect();
        for port in &ports {
            check::port(&cell, port, &routes, &mut errors);
        }
        let n = cell.nodes.len();
        couples::check(
            &cell,
            &ports,
            |a, b| {
                let (a, b) = (cell.tasks[a.index()].node, cell.tasks[b.index()].node);
                let hop = routes[a.index() * n + b.index()];
                if a == b { Ticks::ZERO } else { hop.map_or(Ticks::FAR, |hop| hop.bound) }
            },
            &mut errors,
        );
        if !errors.is_empty() {
            return Err(errors);
        }
        let mut ports_of = vec![Vec::new(); cell.tasks.len()];
        let mut meetings_of = vec![0; cell.tasks.len()];
        for port in &mut ports {
            for party in &mut port.parties {
                let own = &mut ports_of[party.task.index()];
                party.place = u16::try_from(own.len()).unwrap_or(u16::MAX);
                own.push(port.id);
                let meetings = &mut meetings_of[party.task.index()];
                party.meeting = *meetings;
                *meetings += u16::from(port.decl.usage == Usage::Waitfor);
            }
        }
        let ports_of = ports_of.into_iter().map(Vec::into_boxed_slice).collect();
        let digest = digest::of_cell(&cell, &ports);
        let mut beside = vec![0_u16; n];
        let place = |task: &TaskDecl| {
            let place = &mut beside[task.node.index()];
            *place += 1;
            (task.node, *place - 1)
        };
        let locations = cell.tasks.iter().map(place).collect();
        let (held_back, decided) = (Box::default(), cell.rules == Rules::DEFAULT);
        let (epoch, compiled) = (0, Box::default());
        let mut table = Self {
            cell,
            ports: compiled,
            digest,
            epoch,
            avoid,
            routes,
            ports_of,
            locations,
            held_back,
            decided,
        };
        ports.iter_mut().for_each(|port| table.compile_ends(port));
        table.ports = ports;
        table.held_back = table.hold_back();
        Ok(table)
    }

    /// Whether the cell runs [`Rules::DEFAULT`]. Fused steps exist for these rules only.
    pub(crate) const fn is_decided(&self) -> bool {
        self.decided
    }

    /// The declarations of the cell.
    #[must_use]
    pub const fn cell(&self) -> &Cell {
        &self.cell
    }

    /// The digest of the canonical table: nodes that differ in it do not talk (D48).
    #[must_use]
    pub const fn digest(&self) -> u32 {
        self.digest
    }

    /// Which of the cell's tables this is: 0 for that of [`new`](Self::new). In running nodes a table of a later epoch
    /// replaces this one (D184).
    #[must_use]
    pub const fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The links and nodes that the routes avoid.
    #[must_use]
    pub const fn avoided(&self) -> &Avoid {
        &self.avoid
    }

    /// The port `id`, if the cell has it.
    #[must_use]
    pub fn port(&self, id: PortId) -> Option<&Port> {
        self.ports.get(id.index())
    }

    /// All ports in the order of their ids.
    #[must_use]
    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    /// The ports that `task` owns or uses, ascending.
    #[must_use]
    pub fn ports_of(&self, task: TaskId) -> &[PortId] {
        self.ports_of.get(task.index()).map_or(&[], |p| p)
    }

    /// The node that `task` runs on.
    #[must_use]
    pub fn location(&self, task: TaskId) -> Option<NodeId> {
        self.locations.get(task.index()).map(|&(node, _)| node)
    }

    /// The tasks that run on `node`.
    pub fn tasks_on(&self, node: NodeId) -> impl Iterator<Item = TaskId> + '_ {
        let tasks = self.cell.tasks.iter().enumerate();
        tasks.filter(move |(_, t)| t.node == node).map(|(i, _)| TaskId::from_index(i))
    }

    /// The neighbour to which `from` sends packets for `to` (§5.2.3).
    #[must_use]
    pub fn next_hop(&self, from: NodeId, to: NodeId) -> Option<NodeId> {
        self.hop(from, to).map(|h| h.next)
    }

    /// The nodes that packets from one node to another pass, both of these nodes included.
    pub(crate) fn path(&self, from: NodeId, to: NodeId) -> impl Iterator<Item = NodeId> + '_ {
        let next = move |&node: &NodeId| self.next_hop(node, to).filter(|_| node != to);
        core::iter::successors(Some(from), next).take(usize::from(MAX_HOPS) + 2)
    }

    /// The summed bounds of the links between two nodes; zero within one node.
    #[must_use]
    pub fn path_bound(&self, from: NodeId, to: NodeId) -> Option<Ticks> {
        if from == to { Some(Ticks::ZERO) } else { self.hop(from, to).map(|h| h.bound) }
    }

    /// [`path_bound`](Self::path_bound) between the nodes of two tasks. The table has checked that tasks of one port reach
    /// each other; between tasks without a common port it may be [`Ticks::FAR`].
    #[must_use]
    pub fn bound_between(&self, from: TaskId, to: TaskId) -> Ticks {
        let bound = self.location(from).zip(self.location(to)).and_then(|(a, b)| self.path_bound(a, b));
        bound.unwrap_or(Ticks::FAR)
    }

    /// The declared bound of the link between two neighbours.
    #[must_use]
    pub fn link_bound(&self, a: NodeId, b: NodeId) -> Option<Ticks> {
        let joins = |l: &&crate::cell::LinkDecl| (l.a, l.b) == (a, b) || (l.a, l.b) == (b, a);
        self.cell.links.iter().filter(joins).map(|l| l.delay).min()
    }

    /// The nodes that a link joins with `node`.
    pub fn neighbours(&self, node: NodeId) -> impl Iterator<Item = NodeId> + '_ {
        let mut seen = BTreeSet::new();
        self.cell.links.iter().filter_map(move |l| {
            let other = if l.a == node {
                l.b
            } else if l.b == node {
                l.a
            } else {
                return None;
            };
            seen.insert(other).then_some(other)
        })
    }

    fn hop(&self, from: NodeId, to: NodeId) -> Option<Hop> {
        let n = self.cell.nodes.len();
        if from.index() >= n || to.index() >= n {
            return None;
        }
        self.routes[from.index() * n + to.index()]
    }
}

fn compile_port(cell: &Cell, id: PortId, decl: &PortDecl, routes: &[Option<Hop>]) -> Port {
    let (retry, rate) = (decl.retry, decl.rate);
    let party = |task, usage, time_out, (retry, rate)| Party {
        task,
        usage,
        time_out,
        retry,
        rate,
        place: 0,
        local: 0,
        meeting: 0,
        peers: Box::default(),
    };
    let owner = party(decl.owner, decl.usage, decl.time_out, (retry, rate));
    let user = |user: &UserDecl| {
        let sends = (user.retry.unwrap_or(retry), user.rate.or(rate));
        party(user.task, decl.usage.counterpart(), user.time_out.unwrap_or(decl.time_out), sends)
    };
    let users = decl.users.iter().map(user);
    // A module stands for all its tasks, except the owner of the port and the users that are named already (D32).
    let of_module = |t: &TaskDecl| t.module.as_ref().is_some_and(|module| decl.modules.contains(module));
    // Most ports name no module. A scan of all tasks for every port would cost the product of their numbers.
    let tasks = if decl.modules.is_empty() { &[][..] } else { &cell.tasks[..] };
    let others = tasks.iter().enumerate().filter(|(_, t)| of_module(t)).map(|(i, _)| TaskId::from_index(i));
    let unnamed = others.filter(|&t| t != decl.owner && decl.users.iter().all(|u| u.task != t));
    let parties: Box<[Party]> =
        core::iter::once(owner).chain(users).chain(unnamed.map(|task| user(&UserDecl::new(task)))).collect();
    let closed_form =
        || margin::least_margin(farthest(cell, &parties, routes), decl.losses, decl.resend, cell.tick);
    let margin = match decl.usage {
        Usage::Waitfor => decl.margin.unwrap_or_else(closed_form),
        _ => Ticks::ZERO,
    };
    Port { id, decl: decl.clone(), hash: digest::of_port(decl), parties, node: None, margin }
}

/// The longest path bound between any two parties of a port.
fn farthest(cell: &Cell, parties: &[Party], routes: &[Option<Hop>]) -> Ticks {
    let node = |p: &Party| cell.tasks[p.task.index()].node.index();
    let pairs = parties.iter().flat_map(|a| parties.iter().map(move |b| (node(a), node(b))));
    let bounds = pairs.filter(|(a, b)| a != b).map(|(a, b)| routes[a * cell.nodes.len() + b]);
    bounds.map(|hop| hop.map_or(Ticks::FAR, |h| h.bound)).max().unwrap_or(Ticks::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::MAX_NODES;
    use alloc::string::ToString;

    fn three(delay: u64) -> Cell {
        let mut cell = Cell::new("three", Ticks(1));
        let nodes: Vec<_> = ["a", "b", "c"].map(|n| cell.node(n)).into();
        for i in 0..3 {
            cell.task(["x", "y", "z"][i], nodes[i]);
        }
        cell.link(nodes[0], nodes[1], Ticks(delay));
        cell.link(nodes[1], nodes[2], Ticks(delay));
        cell
    }

    const X: TaskId = TaskId(0);
    const Y: TaskId = TaskId(1);
    const Z: TaskId = TaskId(2);

    #[test]
    fn routes_are_computed_a_priori_through_relays() {
        let table = CellTable::new(three(4)).unwrap();
        assert_eq!(table.next_hop(NodeId(0), NodeId(2)), Some(NodeId(1)));
        assert_eq!(table.path_bound(NodeId(0), NodeId(2)), Some(Ticks(8)));
        assert_eq!(table.path_bound(NodeId(2), NodeId(2)), Some(Ticks::ZERO));
        assert_eq!(table.bound_between(X, Z), Ticks(8));
        assert_eq!(table.neighbours(NodeId(1)).collect::<Vec<_>>(), [NodeId(0), NodeId(2)]);
        assert_eq!(table.next_hop(NodeId(0), NodeId(9)), None);
    }

    /// The routing table has an entry for each pair of nodes, which limits their number.
    #[test]
    fn the_routes_of_the_largest_cell_fit_into_a_few_megabytes() {
        let line = |nodes: usize| {
            let mut cell = Cell::new("line", Ticks(1));
            let nodes: Vec<_> = (0..nodes).map(|i| cell.node(&alloc::format!("n{i}"))).collect();
            nodes.windows(2).for_each(|pair| cell.link(pair[0], pair[1], Ticks(1)));
            cell
        };
        let table = CellTable::new(line(MAX_NODES)).unwrap();
        assert!(size_of_val(&*table.routes) <= 8 << 20, "{}", size_of_val(&*table.routes));
        assert_eq!(table.path_bound(NodeId(0), NodeId(511)), Some(Ticks(511)));
        let refused = CellTable::new(line(6_000)).unwrap_err();
        assert_eq!(refused, [CellError::TooMany("nodes", MAX_NODES)]);
        assert!(refused[0].to_string().contains("more than 512 nodes"));
    }

    #[test]
    fn peers_follow_the_usage() {
        let mut cell = three(1);
        let halt = cell.port(PortDecl::new("halt", X, Usage::Send, &[Y, Z], Ticks(9)));
        let meet = cell.port(PortDecl::new("meet", X, Usage::Waitfor, &[Y, Z], Ticks(90)));
        let table = CellTable::new(cell).unwrap();
        let peers = |port, task| table.port(port).unwrap().peers(task).collect::<Vec<_>>();
        assert_eq!(peers(halt, X), [Y, Z]);
        assert_eq!(peers(halt, Z), [X]);
        assert_eq!(peers(meet, Y), [X, Z]);
        assert!(table.port(halt).unwrap().admits(X, Y) && !table.port(halt).unwrap().admits(Y, Z));
        assert!(table.port(meet).unwrap().admits(Y, Z));
    }

    #[test]
    fn the_digest_tells_tables_apart_but_not_the_order_of_links() {
        let digest = |cell| CellTable::new(cell).unwrap().digest();
        let base = digest(three(1));
        let mut swapped = three(1);
        swapped.links.reverse();
        let link = &mut swapped.links[0];
        core::mem::swap(&mut link.a, &mut link.b);
        assert_eq!(digest(swapped), base);
        assert_ne!(digest(three(2)), base);
        let mut renamed = three(1);
        renamed.tasks[0].name = "xx".into();
        assert_ne!(digest(renamed), base);
        let mut port = three(1);
        port.port(PortDecl::new("p", X, Usage::Send, &[Y], Ticks(9)));
        let one = digest(port.clone());
        port.ports[0].time_out = Ticks(10);
        assert_ne!(digest(port), one);
    }
}
