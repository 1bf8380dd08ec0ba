//! The whole state of a communication task: its one walk (D165), the moves of its clock, what of it is dead, and whether one
//! that was read from a file can be worked on.

use super::{CommTask, Lease, Machines, Pending};
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

    /// Whether a state that was read from a file has the lists of a new machine of its task, of the same lengths and for the
    /// same ports and tasks, and every position in it names something that is there. Then no input makes it panic: a keyframe
    /// of a recording is bytes that anybody may have written. [`invariants::check`](crate::invariants::check) says what else
    /// must hold.
    #[must_use]
    pub fn is_whole(&self, table: &NodeTable) -> bool {
        if table.location(self.own.task).is_none() {
            return false;
        }
        let new = Self::new(table, self.own.task, self.own.incarnation, self.own.restarted);
        let Machines { client, server, interrupts, meetings, lease } = &self.machines;
        let is_leased = match (lease, &new.machines.lease) {
            (Some(read), Some(new)) => read.is_like(new),
            (None, None) => true,
            (Some(_), None) | (None, Some(_)) => false,
        };
        self.own.is_like(&new.own)
            && client.is_like(&new.machines.client)
            && server.is_like(&new.machines.server)
            && meetings.is_like(&new.machines.meetings)
            && is_leased
            && interrupts.is_whole(|wait| match wait {
                Pending::Reply(desk) => client.has(desk),
                Pending::Meeting(meeting) => meetings.has(meeting),
                Pending::Lease => lease.is_some(),
                Pending::Get { port, .. } => port.is_none_or(|port| self.own.inbox(port).is_some()),
                Pending::Nothing | Pending::Delay(..) | Pending::Work | Pending::Boundary => true,
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::Incarnation;
    use crate::task::fixture::{A, B, Fixture, LIFT, MOVE};
    use crate::task::invariants::{Violation, check};
    use crate::ticks::Instant;

    #[test]
    fn a_deadline_that_is_kept_and_is_not_the_next_one_is_found() {
        let table = Fixture::new(B).table;
        let mut task = CommTask::new(&table, B, Incarnation(0), false);
        assert_eq!(task.next_deadline(), Instant::START, "its first beat");
        task.due = Some(Instant::START);
        assert_eq!(check(&task, &table), Ok(()));
        task.due = Some(Instant(1));
        assert_eq!(check(&task, &table), Err(Violation::WrongDeadline));
    }

    /// Bytes that anybody may have written: what an input would work on must be there.
    #[test]
    fn a_wait_for_what_is_not_there_is_not_whole() {
        let table = Fixture::new(A).table;
        let waiting = |wait: Pending| {
            let mut task = CommTask::new(&table, A, Incarnation(0), false);
            task.machines.interrupts.wait(wait);
            task.is_whole(&table)
        };
        let get = |port| Pending::Get { port, source: None, deadline: Instant::NEVER };
        assert!(waiting(get(None)) && waiting(Pending::Reply(0)) && waiting(Pending::Meeting(0)));
        assert!(waiting(Pending::Lease) && waiting(Pending::Work));
        // A asks on one of these ports, and meets B on the other: it receives on neither.
        assert!(!waiting(get(Some(MOVE))) && !waiting(get(Some(LIFT))));
        assert!(!waiting(Pending::Reply(1)) && !waiting(Pending::Meeting(1)));
    }
}
