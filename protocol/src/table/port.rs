//! A checked port and its ends.

use crate::cell::{PortDecl, Rate, Usage};
use crate::ids::{NodeId, PortId, TaskId};
use crate::ticks::Ticks;
use alloc::boxed::Box;

/// One end of a port: a task that owns or uses the port, and the facts that a step of this task needs about the port.
#[derive(Clone, Debug)]
pub struct Party {
    /// The task at this end.
    pub task: TaskId,
    /// What the task does with the port.
    pub usage: Usage,
    /// The default time_out of the task's own requests on the port.
    pub time_out: Ticks,
    /// How often the task's class-2 messages are retransmitted within that time_out (D5).
    pub retry: u8,
    /// The highest rate at which the task sends (D53).
    pub rate: Option<Rate>,
    /// The position of the port among those of the task, by which the communication task finds its state for the port
    /// without a search.
    pub place: u16,
    /// The position of the task among those of its node, ascending by task.
    pub(crate) local: u16,
    /// For a `waitfor` (rendezvous): the position of the port among the task's ports with this usage.
    pub(crate) meeting: u16,
    /// The other ends to which this end sends and from which it hears, ascending by task.
    pub(crate) peers: Box<[Peer]>,
}

/// What an end of a port knows of another end: how their tasks reach each other, and where each keeps its state about
/// the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Peer {
    pub task: TaskId,
    /// The position of the other end among the parties of the port.
    pub party: u16,
    /// The other end's position among this end's [`peers`](Party::peers). An inbox uses it as the position of the source.
    pub slot: u16,
    /// The other end's position among this end's peers in the order of the parties. An outstanding request uses it as the
    /// position of the recipient.
    pub recipient: u16,
    /// The slot of this end among the peers of the other end.
    pub back: u16,
    /// The neighbour through which packets of the other end reach this node; `None` if both tasks run on one node.
    pub ingress: Option<NodeId>,
    /// The summed bounds of the links between the nodes of the two ends. The sums are the same in both directions.
    pub bound: Ticks,
}

/// A port with the two ends that exchange a packet: the result of the one look-up of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends<'a> {
    pub port: &'a Port,
    /// The end of the task that makes the step.
    pub own: &'a Party,
    pub peer: &'a Peer,
}

impl<'a> Ends<'a> {
    /// The end of the other task.
    pub fn other(&self) -> &'a Party {
        &self.port.parties[usize::from(self.peer.party)]
    }
}

impl Party {
    /// The time_out of a request of the task. The other tasks of the port rely on the declared time_out, so a request may
    /// only shorten it.
    #[inline]
    pub(crate) fn time_out_of(&self, wanted: Option<Ticks>) -> Ticks {
        wanted.map_or(self.time_out, |wanted| wanted.min(self.time_out))
    }

    /// What this end knows of the end of `task`, if this end sends to it and hears from it.
    #[inline]
    pub(crate) fn peer(&self, task: TaskId) -> Option<&Peer> {
        if let [only] = &*self.peers {
            Some(only).filter(|only| only.task == task)
        } else {
            self.one_of_many(task)
        }
    }

    #[inline(never)]
    fn one_of_many(&self, task: TaskId) -> Option<&Peer> {
        self.peers.get(self.peers.binary_search_by_key(&task, |peer| peer.task).ok()?)
    }
}

/// A checked port.
#[derive(Clone, Debug)]
pub struct Port {
    /// The port's identifier.
    pub id: PortId,
    /// The port's declaration.
    pub decl: PortDecl,
    /// Owner first, then the users in the order of the `user_list`.
    pub parties: Box<[Party]>,
    /// The node on which all parties run; `None` if they run on several nodes.
    pub(crate) node: Option<NodeId>,
    /// The hash that the checksum of each of the port's packets covers first (D47).
    pub hash: u32,
    /// The margin of a `waitfor`: the patience that each arrival must have left at a release (D2, D56). Zero on other
    /// ports.
    pub margin: Ticks,
}

impl Port {
    /// The position of `task` among the parties.
    #[must_use]
    pub fn party_index(&self, task: TaskId) -> Option<usize> {
        let owner = self.parties.first()?;
        if owner.task == task { Some(0) } else { owner.peer(task).map(|peer| peer.party.into()) }
    }

    /// The end of `task` at the port.
    #[must_use]
    #[inline]
    pub fn party(&self, task: TaskId) -> Option<&Party> {
        let (owner, users) = self.parties.split_first()?;
        let party = match users {
            _ if owner.task == task => owner,
            // Most ports have one user, so this case comes first.
            [user] => user,
            _ => &self.parties[usize::from(owner.one_of_many(task)?.party)],
        };
        (party.task == task).then_some(party)
    }

    /// The tasks at the other end from `task`: the owner for a user, the users for the owner, all others in a `waitfor`.
    pub fn peers(&self, task: TaskId) -> impl Iterator<Item = TaskId> + '_ {
        let everyone = self.decl.usage == Usage::Waitfor;
        let own = task == self.decl.owner;
        self.parties
            .iter()
            .map(|p| p.task)
            .filter(move |&peer| peer != task && (everyone || own || peer == self.decl.owner))
    }

    /// Whether `source` may send `task` messages through this port (the insertion rule of a black channel).
    #[must_use]
    pub fn admits(&self, source: TaskId, task: TaskId) -> bool {
        self.ends(task, source).is_some()
    }

    /// The port with the ends of `own` and `other`, if these tasks may send to each other.
    pub(crate) fn ends(&self, own: TaskId, other: TaskId) -> Option<Ends<'_>> {
        let own = self.party(own)?;
        Some(Ends { port: self, own, peer: own.peer(other)? })
    }
}
