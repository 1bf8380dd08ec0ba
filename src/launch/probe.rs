//! How the tasks of a node tell the launcher what happens to them, without ever waiting for it.

use super::clock::now_us;
use super::lines::{Acted, Event, Outcomes, What};
use imrs_protocol::{CellTable, Outcome, PortId, Round, TaskId};
use imrs_runtime::Sent;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A task's way to the launcher. All tasks of a node share one.
#[derive(Clone)]
pub struct Probe {
    shared: Arc<Shared>,
    told: Sender<Event>,
}

struct Shared {
    /// By port: its time_out in microseconds.
    time_outs: Box<[u64]>,
    counts: Mutex<(Outcomes, Acted)>,
    open: Mutex<bool>,
    opened: Condvar,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Probe {
    /// A probe that tells events to `told`.
    pub fn new(table: &CellTable, told: Sender<Event>) -> Self {
        let time_outs = table.ports().iter().map(|port| port.decl.time_out.0).collect();
        let shared =
            Shared { time_outs, counts: Mutex::default(), open: Mutex::new(false), opened: Condvar::new() };
        Self { shared: Arc::new(shared), told }
    }

    /// Keeps the tasks from starting until the node hears what they do and knows its neighbours.
    pub fn wait_for_start(&self) {
        let mut open = lock(&self.shared.open);
        while !*open {
            open = self.shared.opened.wait(open).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Lets the tasks start.
    pub fn start(&self) {
        *lock(&self.shared.open) = true;
        self.shared.opened.notify_all();
    }

    /// The task was released, just now.
    pub fn released(&self, task: TaskId, port: PortId, round: Round) {
        self.tell(Event { at: now_us(), task, port, round, what: What::Released });
    }

    /// The task gave up, just now; it had asked at `asked`.
    pub fn gave_up(&self, task: TaskId, port: PortId, round: Round, asked: u64, missing: u64) {
        let at = now_us();
        self.tell(Event { at, task, port, round, what: What::GaveUp { waited: at - asked, missing } });
    }

    /// A `send` of the task ended.
    pub fn sent(&self, sent: Sent) {
        let mut counts = lock(&self.shared.counts);
        let outcomes = &mut counts.0;
        match sent {
            Sent::Copies(_) => {}
            Sent::Outcome(Outcome::Reply(_)) => outcomes.replies += 1,
            Sent::Outcome(Outcome::Refused) => outcomes.refused += 1,
            Sent::Outcome(Outcome::TimedOutUnsent) => outcomes.timed_out_unsent += 1,
            Sent::Outcome(Outcome::TimedOutUnknown) => outcomes.timed_out_unknown += 1,
            Sent::Outcome(Outcome::PeerRestarted) => outcomes.peer_restarted += 1,
        }
    }

    /// The task carried out a command of this age in microseconds.
    pub fn executed(&self, port: PortId, age: u64) {
        let late = self.shared.time_outs.get(port.index()).is_some_and(|&time_out| age > time_out);
        let mut counts = lock(&self.shared.counts);
        let acted = Acted { executed: 1, executed_late: u64::from(late), turned_away: 0, oldest_us: age };
        counts.1 += acted;
    }

    /// The task did not carry out a command, because its sender is beyond waiting.
    pub fn turned_away(&self) {
        lock(&self.shared.counts).1.turned_away += 1;
    }

    /// The counts so far.
    pub fn counts(&self) -> (Outcomes, Acted) {
        *lock(&self.shared.counts)
    }

    fn tell(&self, event: Event) {
        // Nobody listens any more when the node ends.
        let _ = self.told.send(event);
    }

    /// A probe that nobody listens to.
    #[cfg(test)]
    pub fn detached() -> Self {
        let table = CellTable::new(crate::cells::beam_lift::cell()).expect("a sound cell");
        Self::new(&table, std::sync::mpsc::channel().0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_late_when_it_is_older_than_its_ports_time_out() {
        let probe = Probe::detached();
        let beat = PortId(1);
        probe.executed(beat, 20_000);
        probe.executed(beat, 20_001);
        probe.executed(beat, 5);
        let (_, acted) = probe.counts();
        assert_eq!(acted, Acted { executed: 3, executed_late: 1, turned_away: 0, oldest_us: 20_001 });
    }
}
