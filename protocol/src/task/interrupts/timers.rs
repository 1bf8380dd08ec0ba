//! A task's delays and timers, which the node's Timer counts (Figure 3, §5.1.2).

use super::offer::{Offer, Turn, What};
use super::{Interrupts, TIMERS};
use crate::ids::PortId;
use crate::packet::Class;
use crate::request::{Fault, TimeId};
use crate::table::NodeTable;
use crate::task::own::Own;
use crate::task::step::Outbox;
use crate::task::wait::{Finished, Pending};
use crate::ticks::{Instant, Ticks};
use serde::{Deserialize, Serialize};

/// A started timer of the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Started {
    pub id: TimeId,
    /// The number of this start of the timer.
    pub turn: u8,
}

/// The timers of a task that run, or whose handlers have not begun.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Timers {
    pub slots: [Option<Started>; TIMERS],
    /// A bit mask: bit `i` says that the timer in slot `i` has ended, and its handler has not begun.
    pub ended: u8,
}

impl Timers {
    fn find(&self, id: TimeId) -> Option<usize> {
        self.slots.iter().position(|slot| slot.is_some_and(|started| started.id == id))
    }

    /// Validates deserialised timers: only slots in use are marked as ended.
    pub fn is_whole(&self) -> bool {
        let is_there = |at: usize| self.slots[at].is_some() || self.ended & (1 << at) == 0;
        (0..TIMERS).all(is_there)
    }

    /// Frees a slot. Returns whether its timer had ended.
    fn take(&mut self, at: usize) -> bool {
        let ended = self.ended & (1 << at) != 0;
        self.slots[at] = None;
        self.ended &= !(1 << at);
        ended
    }

    /// The ended timers and their slots.
    pub fn ended(&self) -> impl Iterator<Item = (TimeId, usize)> {
        let is_over = |&(at, _): &(usize, _)| self.ended & (1 << at) != 0;
        let over = self.slots.iter().enumerate().filter(is_over);
        over.filter_map(|(at, slot)| Some(((*slot)?.id, at)))
    }
}

impl Interrupts {
    fn turn(&mut self) -> u8 {
        let turn = self.next_turn;
        self.next_turn = turn.wrapping_add(1);
        turn
    }

    /// Whether an activation waits in a delay of this name.
    fn is_named(&self, id: TimeId) -> bool {
        self.threads().any(|activation| matches!(activation.pending, Pending::Delay(delay, _) if delay == id))
    }

    /// Lets the running activation wait in a delay.
    pub fn delay(&mut self, id: TimeId, length: Ticks, out: &mut impl Outbox) -> Result<(), Fault> {
        if self.is_named(id) || self.timers.find(id).is_some() {
            return Err(Fault::Busy);
        }
        let turn = self.turn();
        self.wait(Pending::Delay(id, turn));
        out.arm(id, turn, length);
        Ok(())
    }

    /// Starts a timer, or restarts it if it runs.
    pub fn start(&mut self, id: TimeId, length: Ticks, out: &mut impl Outbox) -> Result<(), Fault> {
        if self.is_named(id) {
            return Err(Fault::Busy);
        }
        let turn = self.turn();
        let free = || self.timers.slots.iter().position(Option::is_none);
        let at = self.timers.find(id).or_else(free).ok_or(Fault::TooManyTimers)?;
        self.timers.take(at);
        self.timers.slots[at] = Some(Started { id, turn });
        out.arm(id, turn, length);
        Ok(())
    }

    /// Stops a timer. If the timer has ended and its handler has not begun, the handler will not begin.
    pub fn stop(&mut self, id: TimeId, out: &mut impl Outbox) {
        if let Some(at) = self.timers.find(id)
            && !self.timers.take(at)
        {
            out.disarm(id);
        }
    }

    /// Stops all timers.
    pub fn stop_all(&mut self, out: &mut impl Outbox) {
        // The timers stop in the order of their names, because packed states do not contain the slots.
        while let Some(id) = self.timers.slots.iter().flatten().map(|started| started.id).min() {
            self.stop(id, out);
        }
    }

    /// The node's Timer reports the end of a delay or a timer. Returns whether the running activation waited in that delay.
    pub fn time_is_over(&mut self, id: TimeId, turn: u8) -> bool {
        let Timers { slots, ended } = &mut self.timers;
        if let Some(at) = slots.iter().position(|slot| *slot == Some(Started { id, turn })) {
            *ended |= 1 << at;
        }
        self.conclude(Pending::Delay(id, turn), &Finished::TimeOut(id))
    }

    /// Whether some timer has ended and its handler has not begun.
    pub const fn has_ended_timer(&self) -> bool {
        self.timers.ended != 0
    }

    /// The first ended timer that outranks the running activation.
    pub fn first_timer(&self, table: &NodeTable, own: &Own) -> Option<Offer> {
        let offers = self.timers.ended().filter_map(|(id, at)| {
            let rank = own.order.timer(id);
            let key = (Turn::InOrder, rank, Instant::START, Class::Command, PortId(0), u64::from(id.0));
            self.outranks(table, own, rank, false).then_some(Offer { key, what: What::Timer(at) })
        });
        offers.min()
    }

    /// Frees the slot of an ended timer, because the timer's handler begins. Returns the timer's name.
    pub fn take_timer(&mut self, at: usize) -> TimeId {
        let id = self.timers.slots[at].map_or(TimeId(0), |started| started.id);
        self.timers.take(at);
        id
    }
}
