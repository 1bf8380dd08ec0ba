//! The whole state of a communication task for a checker: its one walk (D165), the moves of its clock, and what of it is dead.

use super::lease::Lease;
use super::step::Outbox;
use super::{CommTask, Machines};
use crate::ids::{PortId, Seq24, TaskId};
use crate::state::{Clock, Pass, Walk, restart};
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// A message that may still come to a task: it is on a link or in a buffer, or its sender waits for the answer and may send
/// it again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coming {
    /// On which port.
    pub port: PortId,
    /// From whom.
    pub source: TaskId,
    /// To whom.
    pub to: TaskId,
    /// Its number.
    pub sequence: Seq24,
}

impl CommTask {
    /// Walks the state. [`bury`](Self::bury) it before it is written.
    ///
    /// A pass that changes it keeps the order of instants; one that reads must read bytes of the same task.
    pub fn walk<W: Walk>(&mut self, table: &NodeTable, w: &mut W) {
        let Self { own, machines, due } = self;
        let Machines { client, server, interrupts, meetings, lease } = machines;
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            *due = None;
        }
        // In the order of packed bytes (D51): a checker sorts equal members by their bytes, so another order would pick others
        // and change the numbers of states.
        own.walk(w);
        interrupts.walk(&mut own.order, lease.as_ref().map(Lease::couple), w);
        client.walk_overdue(table, (own.task, own.incarnation), w);
        own.walk_life(w);
        server.walk_lives(w);
        own.walk_staged(w);
        client.walk(table, (own.task, own.incarnation), w);
        server.walk(table, own, w);
        meetings.walk(table, interrupts, w);
        if let Some(lease) = lease {
            lease.walk(own.task, w);
        }
        server.walk_guards(w);
    }

    /// Looks for what time alone makes the task do, whether its deadline has come or not: where it has not, nothing comes of it.
    pub fn look_around(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        self.act(table, out);
    }

    /// Sets the internal clock back to zero; behaviour does not change. Dead state is dropped first, so that no
    /// forgotten instant lies before the new zero.
    pub fn rebase(&mut self, table: &NodeTable) {
        self.bury();
        let now = self.own.now;
        self.walk(table, &mut restart(now));
    }

    /// Moves the internal clock `ahead`, and every instant with it; behaviour does not change, however far, because
    /// no instant ever leaves the task (D37).
    pub fn set_ahead(&mut self, table: &NodeTable, ahead: Ticks) {
        self.walk(table, &mut Clock(|instant| instant + ahead));
    }

    /// Drops what can never matter again, so that equal futures have equal states. Behaviour does not change.
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

    /// Forgets which messages it has taken where no copy of them can come any more: for a checker, which knows all that
    /// may still come. Behaviour does not change.
    pub fn bury_seen(&mut self, coming: &[Coming]) {
        let own = self.own.task;
        self.machines.server.bury_seen(|port, task| {
            let is = move |c: &&Coming| (c.port, c.source, c.to) == (port, task, own);
            coming.iter().filter(is).map(|c| c.sequence)
        });
    }
}
