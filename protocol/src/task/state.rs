//! Validation of a deserialised communication task.

use super::{CommTask, Machines, Pending};
use crate::table::NodeTable;

impl CommTask {
    /// Validates a deserialised state, because a keyframe of a recording may come from an untrusted file. The lists of the
    /// state must have the lengths, ports and tasks of a new machine of the same task, and every position in the state must
    /// exist. Then no input makes the machine panic. [`invariants::check`](crate::invariants::check) checks everything
    /// else.
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
                Pending::Reply(request) => client.has(request),
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
    use crate::ids::{Incarnation, NodeId};
    use crate::request::Request;
    use crate::table::CellTable;
    use crate::task::Input;
    use crate::task::fixture::{A, B, Effects, Fixture, LIFT, MOVE};
    use crate::task::invariants::{Violation, check};
    use crate::ticks::{Instant, Ticks};
    use alloc::format;
    use alloc::sync::Arc;

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

    /// Compares the passing of time alone with the same time as an input, up to the next deadline. Beyond that deadline
    /// [`let_idle_time_pass`](CommTask::let_idle_time_pass) must refuse.
    #[test]
    fn idle_time_passes_up_to_the_next_deadline() {
        let table = Fixture::new(A).table;
        let mut task = CommTask::new(&table, A, Incarnation(0), false);
        let get = Request::Get { port: None, source: None, time_out: Some(Ticks(5)) };
        task.handle(&table, Instant(0), &Input::Request(get), &mut Effects::default());
        assert_eq!(task.next_deadline(), Instant(5), "the end of the wait");
        let mut by_input = task.clone();
        by_input.handle(&table, Instant(4), &Input::Time, &mut Effects::default());
        assert!(task.let_idle_time_pass(&table, Instant(4)));
        assert_eq!(format!("{task:?}"), format!("{by_input:?}"));
        assert!(task.let_idle_time_pass(&table, Instant(3)), "an older now is no time");
        assert_eq!(task.now(), Instant(4));
        assert!(!task.let_idle_time_pass(&table, Instant(5)), "the wait ends");
        let mut lenient = table.cell().clone();
        lenient.rules.charge_residence = false;
        let cell = Arc::new(CellTable::new(lenient).expect("a cell"));
        let mut waits = CommTask::new(&table, A, Incarnation(0), false);
        assert!(!waits.let_idle_time_pass(&NodeTable::new(cell, NodeId(0)), Instant(1)));
        assert_eq!((task.now(), waits.now()), (Instant(4), Instant(0)), "nothing has changed");
    }

    /// A keyframe may come from an untrusted file, so the validation must find a wait for an object that does not exist.
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
        // A sends commands on the port `MOVE`, and meets B at `LIFT`. So A receives on neither.
        assert!(!waiting(get(Some(MOVE))) && !waiting(get(Some(LIFT))));
        assert!(!waiting(Pending::Reply(1)) && !waiting(Pending::Meeting(1)));
    }
}
