//! All rendezvous of a task, ordered by when they act next.

use super::{At, Rendezvous};
use crate::ids::NodeId;
use crate::observe::MeetingView;
use crate::packet::Packet;
use crate::queue::Heap;
use crate::table::{NodeTable, Peer, Port};
use crate::task::own::{Own, Role, are_alike, index};
use crate::task::step::{Outbox, Step};
use crate::task::wait::{Ended, Finished, Pending};
use crate::ticks::{Instant, Ticks};
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};

/// The rendezvous of a task: its side of each one in which it takes part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Meetings {
    pub(super) list: Box<[Rendezvous]>,
    /// A heap of the rendezvous, ordered by when each acts next (D108).
    pub(super) next: Heap,
}

impl Meetings {
    /// One rendezvous for each port on which the task takes part in a `waitfor`.
    pub fn new(table: &NodeTable, own: &Own) -> Self {
        let ports = own.ports(table, |role| matches!(role, Role::Meets(_)));
        let numbered = table.rules().rounds;
        let list = ports.map(|(_, port)| Rendezvous::new(port.id, port.parties.len(), numbered));
        let list: Box<[_]> = list.collect();
        Self { next: Heap::new(index(list.len())), list }
    }

    /// Runs a step of one rendezvous. Returns its result, and the end of the wait if the step released the task.
    fn run<R, O: Outbox>(
        &mut self,
        step: &mut Step<'_, O>,
        meeting: u16,
        act: impl FnOnce(&mut Rendezvous, &mut At<'_, '_, O>) -> R,
    ) -> Option<(R, Option<Ended>)> {
        let id = self.list.get(usize::from(meeting))?.port;
        let (port, endpoint) = (step.table.port(id)?, step.own.place(id)?);
        Some(self.run_at(step, (port, endpoint, meeting), act))
    }

    /// As [`run`](Self::run), for a caller that knows the port and the position of its endpoint.
    pub(super) fn run_at<'a, R, O: Outbox>(
        &mut self,
        step: &mut Step<'a, O>,
        (port, endpoint, meeting): (&'a Port, usize, u16),
        act: impl FnOnce(&mut Rendezvous, &mut At<'_, '_, O>) -> R,
    ) -> (R, Option<Ended>) {
        let rendezvous = &mut self.list[usize::from(meeting)];
        let due = rendezvous.due();
        let mut at = At { step, port, endpoint, released: None };
        let done = act(rendezvous, &mut at);
        let released = at.released;
        if rendezvous.due() != due {
            self.touch(meeting);
        }
        let released = released.map(|(round, by)| Finished::Released { port: port.id, round, by });
        (done, released.map(|finished| left(meeting, finished)))
    }

    /// Lets the task reach a rendezvous. If the task is released at once, returns how its wait ended.
    pub fn reach(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        meeting: u16,
        (arguments, patience): ([u8; 8], Ticks),
    ) -> Option<Ended> {
        self.run(step, meeting, |rendezvous, at| rendezvous.reach(at, arguments, patience))?.1
    }

    /// Takes a packet of another member. Returns the end of the wait if the packet releases the task.
    pub fn hear(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        meeting: u16,
        (from, packet): (&Peer, &Packet),
    ) -> Option<Ended> {
        self.run(step, meeting, |rendezvous, at| rendezvous.hear(at, from, packet))?.1
    }

    /// Cancels the task's wait at a rendezvous.
    pub fn leave(&mut self, step: &mut Step<'_, impl Outbox>, meeting: u16) {
        self.run(step, meeting, Rendezvous::leave);
    }

    /// Finds the first rendezvous, at the position `from` or later, at which something is due, and lets it act. Returns its
    /// position, and the end of the wait if the patience ended.
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>, from: u16) -> Option<(u16, Option<Ended>)> {
        let now = step.now();
        if self.next_act() > now {
            return None;
        }
        let due = |&at: &u16| self.list[usize::from(at)].due() <= now;
        let meeting = (from..index(self.list.len())).find(due)?;
        let (gave_up, _) = self.run(step, meeting, |rendezvous, at| {
            rendezvous.advance(at);
            let over = rendezvous.deadline.is_some_and(|deadline| deadline <= at.now());
            let (port, round) = (rendezvous.port, rendezvous.announced);
            over.then(|| Finished::GaveUp { port, round, missing: rendezvous.leave(at) })
        })?;
        Some((meeting, gave_up.map(|finished| left(meeting, finished))))
    }

    /// Notes that a node has a new incarnation: the arrivals of its tasks become void.
    pub fn restarted(&mut self, step: &Step<'_, impl Outbox>, node: NodeId) {
        for rendezvous in &mut self.list {
            let Some(port) = step.table.port(rendezvous.port) else { continue };
            for (i, party) in port.parties.iter().enumerate() {
                if party.task != step.own.task && step.table.location(party.task) == Some(node) {
                    rendezvous.forget(i);
                }
            }
        }
    }

    /// The rendezvous at a position.
    pub fn at(&self, meeting: u16) -> &Rendezvous {
        &self.list[usize::from(meeting)]
    }

    /// As [`at`](Self::at), for a change that moves no instant at which the rendezvous acts.
    pub fn at_mut(&mut self, meeting: u16) -> &mut Rendezvous {
        &mut self.list[usize::from(meeting)]
    }

    /// All rendezvous as a monitor sees them.
    pub fn view(&self, table: &NodeTable, own: &Own) -> impl Iterator<Item = MeetingView> {
        self.list.iter().filter_map(|rendezvous| Some(rendezvous.view(own, table.port(rendezvous.port)?)))
    }

    /// Whether time alone makes no rendezvous act.
    pub fn are_quiet(&self) -> bool {
        self.next.len() == 0
    }

    /// The next instant at which time alone makes one of the rendezvous act.
    pub fn next_act(&self) -> Instant {
        self.next.first_instant(|at| self.list[usize::from(at)].due())
    }

    /// Restores the order of the heap after a change of one rendezvous.
    pub(super) fn touch(&mut self, at: u16) {
        let list = &self.list;
        let act = |at: u16| (list[usize::from(at)].due(), at);
        self.next.set(at, Some(act(at).0).filter(|&due| due != Instant::NEVER), act);
    }

    /// Whether a rendezvous has this position.
    pub fn has(&self, meeting: u16) -> bool {
        usize::from(meeting) < self.list.len()
    }

    /// Validates deserialised rendezvous: their ports and numbers of members are those of new rendezvous.
    pub fn is_like(&self, new: &Self) -> bool {
        let is = |read: &Rendezvous, new: &Rendezvous| {
            (read.port, read.numbered, read.members.len()) == (new.port, new.numbered, new.members.len())
        };
        are_alike(&self.list, &new.list, is) && self.next.is_whole(self.list.len())
    }
}

/// Reports that the wait at a rendezvous ended.
fn left(meeting: u16, finished: Finished) -> Ended {
    Ended { wait: Some(Pending::Meeting(meeting)), finished }
}
