//! The state of a communication task for a checker: functions that visit its fields (D165), shift its clock, and drop dead
//! state.

use super::lease::Lease;
use super::step::Outbox;
use super::{CommTask, Machines};
use crate::ids::{PortId, Seq24, TaskId};
use crate::state::{Clock, Pass, Walk, restart};
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// A message that may still arrive at a task: on a link, in a buffer, or retransmitted by a sender that waits for the
/// answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coming {
    /// The message's port.
    pub port: PortId,
    /// The message's sender.
    pub source: TaskId,
    /// The message's receiver.
    pub to: TaskId,
    /// The message's sequence number.
    pub sequence: Seq24,
}

impl CommTask {
    /// Visits all fields of the state. Call [`bury`](Self::bury) before the state is encoded.
    ///
    /// A pass that changes the state must keep the order of instants. A pass that decodes must get bytes that the same task
    /// wrote.
    pub fn walk<W: Walk>(&mut self, table: &NodeTable, w: &mut W) {
        let Self { own, machines, due } = self;
        let Machines { client, server, interrupts, meetings, lease } = machines;
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            *due = None;
        }
        // The fields are visited in the order of the packed bytes (D51). A checker sorts equal members by their bytes, so
        // another order of fields would pick other representatives and change the numbers of states.
        own.walk(w);
        interrupts.walk(&mut own.order, lease.as_ref().map(Lease::couple), w);
        client.walk_overdue(table, (own.task, own.incarnation), w);
        own.walk_incarnation(w);
        server.walk_incarnations(w);
        own.walk_staged(w);
        client.walk(table, (own.task, own.incarnation), w);
        server.walk(table, own, w);
        meetings.walk(table, interrupts, w);
        if let Some(lease) = lease {
            lease.walk(own.task, w);
        }
        server.walk_guards(w);
    }

    /// Whether both tasks are in the same state, including counters, orders and arrival numbers, which packed bytes leave
    /// out. The next deadlines must be equal, too, but not whether they are cached.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let Self { own, machines, due: _ } = self;
        (own, machines) == (&other.own, &other.machines) && self.next_deadline() == other.next_deadline()
    }

    /// Does everything that time alone makes due. This function does not look at the next deadline first, and does nothing
    /// if that deadline has not come.
    pub fn look_around(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        self.act(table, out);
    }

    /// Sets the task's clock back to zero, which changes no behaviour. Dead state is dropped first, so that no instant is
    /// before the new zero.
    pub fn rebase(&mut self, table: &NodeTable) {
        self.bury();
        let now = self.own.now;
        self.walk(table, &mut restart(now));
    }

    /// Moves the clock and every instant forward by `ahead`. This changes no behaviour, however great `ahead` is, because
    /// no instant ever leaves the task (D37).
    pub fn set_ahead(&mut self, table: &NodeTable, ahead: Ticks) {
        self.walk(table, &mut Clock(|instant| instant + ahead));
    }

    /// Drops dead state, so that states with equal futures are equal. This changes no behaviour.
    pub fn bury(&mut self) {
        self.due = None;
        let now = self.own.now;
        self.own.quarantine_until = self.own.quarantine_until.max(now);
        let Machines { client: _, server, interrupts: _, meetings, lease } = &mut self.machines;
        server.bury(now);
        meetings.bury(now);
        if let Some(lease) = lease {
            lease.bury(now);
        }
    }

    /// Drops dedup entries of messages of which no copy can arrive any more. `coming` has all messages that may still
    /// arrive, which only a checker knows. This changes no behaviour.
    pub fn bury_seen(&mut self, coming: &[Coming]) {
        let own = self.own.task;
        self.machines.server.bury_seen(|port, task| {
            let is = move |c: &&Coming| (c.port, c.source, c.to) == (port, task, own);
            coming.iter().filter(is).map(|c| c.sequence)
        });
    }
}
