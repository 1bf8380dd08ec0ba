//! A task's delays and timers as the node's Timer serves them (Figure 3, §5.1.2).

use super::levels::Finished;
use super::{CommTask, Outbox, Pending};
use crate::request::{Fault, Signal, TimeId};
use crate::ticks::Ticks;
use serde::{Deserialize, Serialize};

/// One timer of the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Started {
    pub id: TimeId,
    /// Which start of it.
    pub turn: u8,
    /// It is over, and its handler has not begun.
    pub ended: bool,
}

/// The timers of a task that run, or whose handlers have not begun.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Timers(pub [Option<Started>; CommTask::TIMERS]);

impl Timers {
    fn find(&mut self, id: TimeId) -> Option<&mut Option<Started>> {
        self.0.iter_mut().find(|slot| slot.is_some_and(|started| started.id == id))
    }

    /// The timers that are over, and where they stand.
    pub fn ended(&self) -> impl Iterator<Item = (TimeId, usize)> {
        self.0.iter().enumerate().filter_map(|(at, slot)| Some((slot.filter(|s| s.ended)?.id, at)))
    }

    /// Takes out a timer that is over.
    pub fn take(&mut self, at: usize) -> TimeId {
        self.0.get_mut(at).and_then(Option::take).map_or(TimeId(0), |started| started.id)
    }
}

impl CommTask {
    fn turn(&mut self) -> u8 {
        let turn = self.next_turn;
        self.next_turn = turn.wrapping_add(1);
        turn
    }

    /// Whether a thread that a handler interrupted delays under this name, or a timer runs under it.
    fn is_named(&self, id: TimeId) -> bool {
        self.running().iter().any(|level| matches!(level.pending, Pending::Delay(delay, _) if delay == id))
    }

    pub(super) fn delay(
        &mut self,
        id: TimeId,
        length: Ticks,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        if self.is_named(id) || self.timers.find(id).is_some() {
            return Err(Fault::Busy);
        }
        let turn = self.turn();
        self.top_mut().pending = Pending::Delay(id, turn);
        out.arm(id, turn, length);
        Ok(None)
    }

    pub(super) fn start(
        &mut self,
        id: TimeId,
        length: Ticks,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        if self.is_named(id) {
            return Err(Fault::Busy);
        }
        let turn = self.turn();
        let started = Some(Started { id, turn, ended: false });
        match self.timers.find(id) {
            Some(slot) => *slot = started,
            None => {
                let free = self.timers.0.iter_mut().find(|slot| slot.is_none());
                *free.ok_or(Fault::TooManyTimers)? = started;
            }
        }
        out.arm(id, turn, length);
        Ok(Some(Signal::Accepted(0)))
    }

    pub(super) fn stop(&mut self, id: TimeId, out: &mut impl Outbox) {
        let stopped = self.timers.find(id).and_then(Option::take);
        if stopped.is_some_and(|started| !started.ended) {
            out.disarm(id);
        }
    }

    pub(super) fn stop_all(&mut self, out: &mut impl Outbox) {
        // In the order of their names: where they stand is not part of a packed state.
        while let Some(id) = self.timers.0.iter().flatten().map(|started| started.id).min() {
            self.stop(id, out);
        }
    }

    /// The node's Timer says that a delay or a timer is over.
    pub(super) fn time_is_over(&mut self, id: TimeId, turn: u8, out: &mut impl Outbox) {
        self.conclude(Pending::Delay(id, turn), Finished::TimeOut(id), out);
        if let Some(Some(started)) = self.timers.find(id)
            && started.turn == turn
        {
            started.ended = true;
        }
    }
}
