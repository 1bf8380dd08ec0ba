//! Compiles what each end of a port knows of the other ends, so that a step looks up nothing by task or node (D180).

use super::port::Peer;
use super::{CellTable, Port};
use crate::cell::Usage;
use crate::ids::{NodeId, TaskId};
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

impl CellTable {
    /// Compiles the peers of every end of a port. The port has been checked: its tasks differ, and each can
    /// reach the others.
    pub(super) fn compile_ends(&self, port: &mut Port) {
        let index = |at: usize| u16::try_from(at).unwrap_or(u16::MAX);
        let tasks: Box<[TaskId]> = port.parties.iter().map(|party| party.task).collect();
        let mut sorted: Vec<usize> = (0..tasks.len()).collect();
        sorted.sort_unstable_by_key(|&at| tasks[at]);
        let mut rank = vec![0; tasks.len()];
        for (place, &at) in sorted.iter().enumerate() {
            rank[at] = place;
        }
        // The owner of a port and each member of a rendezvous hear from all other ends. A user hears from the owner
        // alone.
        let all = |at: usize| at == 0 || port.decl.usage == Usage::Waitfor;
        let slot =
            |of: usize, at: usize| if all(of) { rank[at] - usize::from(rank[of] < rank[at]) } else { 0 };
        let peer = |of: usize, at: usize| Peer {
            task: tasks[at],
            party: index(at),
            slot: index(slot(of, at)),
            recipient: if all(of) { index(at - usize::from(of < at)) } else { 0 },
            back: index(slot(at, of)),
            ingress: self.ingress(tasks[at], tasks[of]),
            bound: self.bound_between(tasks[of], tasks[at]),
        };
        let peers = |of: usize| -> Box<[Peer]> {
            if all(of) {
                sorted.iter().filter(|&&at| at != of).map(|&at| peer(of, at)).collect()
            } else {
                [peer(of, 0)].into()
            }
        };
        let peers: Vec<Box<[Peer]>> = (0..tasks.len()).map(peers).collect();
        for (party, peers) in port.parties.iter_mut().zip(peers) {
            party.peers = peers;
            party.local = self.locations[party.task.index()].1;
        }
        let first = self.location(port.decl.owner);
        port.node = first.filter(|_| tasks.iter().all(|&task| self.location(task) == first));
    }

    /// The last node before that of `to` on the path from `from`; `None` if both tasks are on one node.
    fn ingress(&self, from: TaskId, to: TaskId) -> Option<NodeId> {
        let (from, to) = self.location(from).zip(self.location(to))?;
        self.path(from, to).take_while(|&node| node != to).last()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::{Cell, PortDecl};
    use crate::ticks::Ticks;

    /// A ring of six nodes with two tasks on each, whose paths differ by direction.
    fn ring() -> Cell {
        let mut cell = Cell::new("ring", Ticks(1));
        let nodes: Vec<_> = ["0", "1", "2", "3", "4", "5"].map(|name| cell.node(name)).into();
        for name in ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "l"] {
            cell.task(name, nodes[cell.tasks.len() % 6]);
        }
        for (a, b) in [(0, 1), (1, 4), (4, 5), (0, 2), (2, 3), (3, 5)] {
            cell.link(nodes[a], nodes[b], Ticks(10));
        }
        cell
    }

    #[test]
    fn the_compiled_ends_say_what_the_declaration_does() {
        let mut cell = ring();
        let [users, members] = [[9, 0, 11, 6, 3], [2, 8, 10, 1, 4]].map(|tasks| tasks.map(TaskId));
        let ports = [
            PortDecl::new("told", TaskId(5), Usage::Send, &users, Ticks(900)),
            PortDecl::new("asks", TaskId(5), Usage::Receive, &users, Ticks(900)).command(),
            PortDecl::new("meet", TaskId(5), Usage::Waitfor, &members, Ticks(900)),
            PortDecl::new("pair", TaskId(7), Usage::Query, &[TaskId(5)], Ticks(900)).command(),
        ]
        .map(|decl| cell.port(decl));
        let table = CellTable::new(cell).unwrap();
        for port in ports.map(|id| table.port(id).unwrap()) {
            assert_eq!(port.node, None, "its parties are on several nodes");
            assert!(port.parties.iter().all(|party| usize::from(party.local) == party.task.index() / 6));
            for (own, other) in (0..12).flat_map(|a| (0..12).map(move |b| (TaskId(a), TaskId(b)))) {
                let is_party = port.parties.iter().any(|party| party.task == own);
                let recipient = port.peers(own).position(|peer| peer == other).filter(|_| is_party);
                let ends = port.ends(own, other);
                assert_eq!(ends.map(|ends| usize::from(ends.peer.recipient)), recipient, "{own} {other}");
                let Some(ends) = ends else { continue };
                let back = port.ends(other, own).unwrap();
                assert_eq!((ends.own.task, ends.other().task, ends.peer.task), (own, other, other));
                assert_eq!((ends.peer.back, back.peer.back), (back.peer.slot, ends.peer.slot));
                assert_eq!(&ends.own.peers[usize::from(ends.peer.slot)], ends.peer);
                assert!(ends.own.peers.is_sorted_by_key(|peer| peer.task));
                let nodes = [own, other].map(|task| table.location(task).unwrap());
                let path: Vec<_> = table.path(nodes[1], nodes[0]).collect();
                assert_eq!(ends.peer.ingress, path.iter().rev().nth(1).copied(), "{own} {other}");
                assert_eq!(table.path_bound(nodes[0], nodes[1]), Some(ends.peer.bound));
                assert_eq!(back.peer.bound, ends.peer.bound);
            }
        }
    }
}
