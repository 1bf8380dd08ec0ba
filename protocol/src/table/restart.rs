//! How long messages to and from the earlier incarnation of a restarted node may still arrive (D49, D67, D94, D157).

use super::{CellTable, Party, Port};
use crate::cell::Usage;
use crate::ids::TaskId;
use crate::packet::Class;
use crate::ticks::Ticks;
use alloc::boxed::Box;

impl CellTable {
    /// How long commands and arrivals for an earlier incarnation of `task` may still arrive. During this time its communication
    /// task answers commands with RESTARTED (D49) and drops arrivals (D67). Tasks of its own node are exempt: they restarted
    /// too, and their packets to each other never left the node.
    #[must_use]
    pub fn quarantine(&self, task: TaskId) -> Ticks {
        let heard = self.lasting(task).filter(|(_, own)| hears(own.usage));
        let incarnations = heard.flat_map(|(port, own)| {
            let peers = self.elsewhere(port, own.task).filter_map(|peer| port.party(peer));
            peers.map(|peer| peer.time_out + self.bound_between(peer.task, own.task))
        });
        incarnations.max().unwrap_or_default()
    }

    /// How long after its start a restarted node holds back the script of `task` (D94, D157). During this time
    ///
    /// - the task's communication task rejects commands and arrivals for the earlier incarnation
    ///   ([`quarantine`](Self::quarantine)), so the script could only wait until its time_out;
    /// - commands and arrivals that the earlier incarnation sent may still arrive, and be carried out after those of the
    ///   new incarnation;
    /// - or a task of the same node that the script asks or meets is held back.
    ///
    /// Zero for a task that the cell does not have, and for a task without such ports.
    #[must_use]
    pub fn held_back(&self, task: TaskId) -> Ticks {
        self.held_back.get(task.index()).copied().unwrap_or_default()
    }

    /// Computes [`held_back`](Self::held_back) for each task: a task waits for the tasks of its node that it asks or meets.
    pub(super) fn hold_back(&self) -> Box<[Ticks]> {
        let tasks = (0..self.locations.len()).map(TaskId::from_index);
        let mut held: Box<[Ticks]> = tasks.map(|task| self.quarantine(task).max(self.sent(task))).collect();
        loop {
            let mut settled = true;
            for task in (0..held.len()).map(TaskId::from_index) {
                let asked = self.lasting(task).filter(|(_, own)| sends(own.usage));
                let beside = asked.flat_map(|(port, own)| {
                    port.peers(own.task).filter(|&peer| self.location(peer) == self.location(own.task))
                });
                let longest = beside.map(|peer| held[peer.index()]).max().unwrap_or_default();
                if held[task.index()] < longest {
                    held[task.index()] = longest;
                    settled = false;
                }
            }
            if settled {
                return held;
            }
        }
    }

    /// How long commands and arrivals sent by an earlier incarnation of `task` may still arrive anywhere.
    fn sent(&self, task: TaskId) -> Ticks {
        let ports = self.lasting(task).filter(|(_, own)| sends(own.usage));
        let incarnations = ports.flat_map(|(port, own)| {
            self.elsewhere(port, own.task).map(|peer| own.time_out + self.bound_between(own.task, peer))
        });
        incarnations.max().unwrap_or_default()
    }

    /// The ports of `task` that carry commands or arrivals. Heartbeat ports are left out: leases have their own rule for
    /// restarts (D80, D135). So are ports for replies to third parties: no task carries out such a reply, and it expires as
    /// a status message does.
    fn lasting(&self, task: TaskId) -> impl Iterator<Item = (&Port, &Party)> {
        let ports = self.ports_of(task).iter().filter_map(|&id| self.port(id));
        let lasts = |port: &&Port| match port.decl.usage {
            Usage::Waitfor => true,
            Usage::Reply => false,
            Usage::Send | Usage::Receive | Usage::Query | Usage::Response => {
                let heartbeats = self.cell.couples.iter().any(|couple| couple.via == port.id);
                port.decl.class == Class::Command && !heartbeats
            }
        };
        ports.filter(lasts).filter_map(move |port| Some((port, port.party(task)?)))
    }

    /// The tasks at the other end of a port that run on other nodes than `task`.
    fn elsewhere<'a>(&'a self, port: &'a Port, task: TaskId) -> impl Iterator<Item = TaskId> + 'a {
        port.peers(task).filter(move |&peer| self.location(peer) != self.location(task))
    }
}

/// Whether a task with this usage receives commands or arrivals.
const fn hears(usage: Usage) -> bool {
    matches!(usage, Usage::Receive | Usage::Response | Usage::Waitfor)
}

/// Whether a task with this usage sends commands or arrivals.
const fn sends(usage: Usage) -> bool {
    matches!(usage, Usage::Send | Usage::Query | Usage::Waitfor)
}

#[cfg(test)]
mod tests {
    use crate::cell::{Cell, CoupleDecl, PortDecl, Usage, UserDecl};
    use crate::ids::{NodeId, TaskId};
    use crate::table::CellTable;
    use crate::ticks::Ticks;
    use alloc::vec::Vec;

    const FAR: TaskId = TaskId(0);
    /// Three tasks of one node. A link with a delay of two ticks joins this node with the node of [`FAR`].
    const A: TaskId = TaskId(1);
    const B: TaskId = TaskId(2);
    const C: TaskId = TaskId(3);

    fn held(ports: impl FnOnce(&mut Cell)) -> [u64; 4] {
        let mut cell = Cell::new("held", Ticks(1));
        let (there, here) = (cell.node("there"), cell.node("here"));
        cell.link(there, here, Ticks(2));
        cell.task("far", there);
        let _ = ["a", "b", "c"].map(|name| cell.task(name, here));
        ports(&mut cell);
        let table = CellTable::new(cell).expect("a sound cell");
        assert_eq!((table.location(FAR), table.location(C)), (Some(NodeId(0)), Some(NodeId(1))));
        [FAR, A, B, C].map(|task| table.held_back(task).0)
    }

    fn command(owner: TaskId, usage: Usage, user: TaskId, time_out: u64) -> PortDecl {
        PortDecl::new(&alloc::format!("p{}{}", owner.0, user.0), owner, usage, &[user], Ticks(time_out))
            .command()
    }

    #[test]
    fn each_task_is_held_back_for_its_own_ports_alone() {
        let ports = |cell: &mut Cell| {
            cell.port(command(A, Usage::Receive, FAR, 90));
            cell.port(command(FAR, Usage::Receive, B, 20));
            // A port for status messages holds back no task.
            cell.port(PortDecl::new("news", C, Usage::Send, &[FAR], Ticks(500)));
        };
        assert_eq!(held(ports), [92, 92, 22, 0]);
    }

    #[test]
    fn the_time_out_is_that_of_who_sends() {
        let patient = |cell: &mut Cell| {
            let mut port = command(FAR, Usage::Receive, A, 20);
            port.users = Vec::from([UserDecl { time_out: Some(Ticks(70)), ..UserDecl::new(A) }]);
            cell.port(port);
        };
        assert_eq!(held(patient), [72, 72, 0, 0]);
    }

    #[test]
    fn members_reckon_with_each_others_patience_and_their_own() {
        let meet = |cell: &mut Cell| {
            let mut port = PortDecl::new("meet", FAR, Usage::Waitfor, &[A], Ticks(50)).resend(Ticks(6), 0);
            port.users = Vec::from([UserDecl { time_out: Some(Ticks(70)), ..UserDecl::new(A) }]);
            cell.port(port);
        };
        assert_eq!(held(meet), [72, 72, 0, 0]);
    }

    #[test]
    fn tasks_of_one_node_restart_together_and_begin_after_those_that_they_ask() {
        let beside = |cell: &mut Cell| {
            cell.port(command(A, Usage::Query, B, 900));
            cell.port(command(B, Usage::Send, C, 800));
        };
        assert_eq!(held(beside), [0; 4]);
        let last = |cell: &mut Cell| {
            beside(cell);
            cell.port(command(C, Usage::Response, FAR, 30));
        };
        assert_eq!(held(last), [32; 4]);
        let first = |cell: &mut Cell| {
            beside(cell);
            cell.port(command(A, Usage::Response, FAR, 30));
        };
        assert_eq!(held(first), [32, 32, 0, 0], "who is asked may wait for who asks");
    }

    #[test]
    fn heartbeats_and_replies_to_third_parties_hold_nobody_back() {
        let ports = |cell: &mut Cell| {
            let via = cell.port(command(FAR, Usage::Response, A, 40));
            cell.couples.push(CoupleDecl {
                primary: FAR,
                standby: A,
                lease: Ticks(100),
                takeover: Ticks(140),
                every: Ticks(20),
                via,
                trusted: true,
                mutual: false,
            });
            cell.port(PortDecl::new("told", B, Usage::Reply, &[FAR], Ticks(90)).command());
        };
        assert_eq!(held(ports), [0; 4]);
    }
}
