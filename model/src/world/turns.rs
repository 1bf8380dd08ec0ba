//! One order of what happens between two ticks instead of all of them (a reduction).
//!
//! What happens at different nodes between two ticks commutes, unless one sends what the other takes in. So of all
//! orders only this one is looked at: the nodes take turns; in its turn a node does as much as it will, and then it is
//! *closed* until a packet comes for it that was sent after its turn, a *fresh* one. Every run has such an order: at a
//! turn's end the node's next event, if it has one, needs a packet that has not been sent yet, or is not of this tick.
//! Which node's turn is next may be any function of the state.
//!
//! What a watch judges must not depend on the order of events that do not need each other, or must be wrong already
//! with nothing done but what the judged event needs: every such start of a run is looked at, too. Losses wait for the
//! last moment before a tick. A crash, a restart and the end of faults are barriers: afterwards all nodes are open.

use super::{Action, World, small};
use crate::scenario::Watch;

impl World {
    /// Whether the order of events between two ticks is reduced.
    pub(super) fn takes_turns(&self) -> bool {
        // `Stale` asks what another node knows when a message is handed over: there the order matters.
        self.scenario.reductions.turns && self.scenario.delay.is_some() && self.scenario.watch != Watch::Stale
    }

    /// What may happen next: in the turn of each node, every node before it being closed by that; at last what needs
    /// all of them closed.
    pub(super) fn actions_in_turns(&self, actions: &mut Vec<Action>) {
        for &i in &self.order {
            self.events(i, actions);
        }
        self.crashes(actions);
        let may_heal = matches!(self.scenario.watch, Watch::MeetAgain { .. });
        let delay = self.scenario.delay.unwrap_or(0);
        let mut overdue = 0;
        let before = actions.len();
        for (at, flight) in self.flights.iter().enumerate() {
            overdue += usize::from(flight.age >= delay);
            let again = at > 0 && self.flights[at - 1] == *flight;
            // What is lost just before the end of all faults may be of any age.
            if self.loss > 0 && !self.healed && !again && (may_heal || flight.age >= delay) {
                actions.push(Action::Lose(small(at)));
            }
        }
        if !may_heal && overdue > 0 {
            // All of them must be lost before time passes: one order of that is enough.
            let enough = overdue <= usize::from(self.loss);
            actions.truncate(before + usize::from(enough));
        }
        if overdue == 0 && !self.is_urgent() {
            self.ticks(actions);
        }
    }

    /// What node `i` may do in its turn.
    fn events(&self, i: usize, actions: &mut Vec<Action>) {
        let open = self.open[i];
        if open {
            self.task_actions(i, actions);
        }
        for (at, flight) in self.flights.iter().enumerate() {
            let here = flight.packet.destination.index() == i && (open || flight.fresh);
            if here && !(at > 0 && self.flights[at - 1] == *flight) {
                self.arrivals(small(at), actions);
            }
        }
    }

    /// Ends the turn of node `i`.
    fn close(&mut self, i: usize) {
        self.open[i] = false;
        self.settle_flights(i);
    }

    /// Closes and opens the nodes as `action` asks for, before it is carried out.
    pub(super) fn take_turn(&mut self, action: Action) {
        let at = match action {
            Action::Act(i) | Action::Answer(i) => usize::from(i),
            Action::Deliver(i) | Action::Overcharge(i, _) | Action::Duplicate(i) => {
                self.flights[usize::from(i)].packet.destination.index()
            }
            Action::Lose(_) => return self.set_open(false),
            Action::Tick | Action::Late(_) | Action::Crash(_) | Action::Restart(_) | Action::Heal => {
                return self.set_open(true);
            }
        };
        let closed: Vec<usize> = self.order.iter().copied().take_while(|&i| i != at).collect();
        for i in closed {
            self.close(i);
        }
        if !self.open[at] {
            self.open[at] = true;
            self.settle_flights(at);
        }
    }

    /// As if nobody took turns: for tests.
    pub fn forget_turns(&mut self) {
        self.set_open(false);
    }

    fn set_open(&mut self, open: bool) {
        self.open.fill(open);
        self.flights.iter_mut().for_each(|flight| flight.fresh = false);
    }

    fn settle_flights(&mut self, to: usize) {
        let here = self.flights.iter_mut().filter(|flight| flight.packet.destination.index() == to);
        here.for_each(|flight| flight.fresh = false);
    }

    /// One form for what is the same: a node that can do nothing is closed; one that has refused nothing is open.
    pub(super) fn tidy_turns(&mut self) {
        if !self.takes_turns() {
            return;
        }
        for i in 0..self.n() {
            let here = || self.flights.iter().filter(|flight| flight.packet.destination.index() == i);
            let mut acts = Vec::new();
            self.task_actions(i, &mut acts);
            let (any, refused) = (here().next().is_some(), here().any(|flight| !flight.fresh));
            if !any && acts.is_empty() {
                self.open[i] = false;
            } else if any && !refused && acts.is_empty() && !self.open[i] {
                self.open[i] = true;
                self.settle_flights(i);
            }
        }
    }
}
