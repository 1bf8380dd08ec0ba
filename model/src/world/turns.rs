//! A partial-order reduction: one interleaving of the steps between two ticks instead of all of them.
//!
//! Steps at different nodes between two ticks commute, unless one node sends a packet that the other receives. So only one
//! interleaving is explored: the nodes take turns. In its turn a node makes any number of steps. Then the node is *closed*
//! until a *fresh* packet arrives for it: one that was sent after the node's turn. Every run has such an interleaving: when
//! a node's turn ends, the node's next step in this tick, if it has one, needs a packet that has not been sent yet. The
//! order of the turns may be any function of the state.
//!
//! The reduction keeps a property's verdict if the property does not depend on the order of independent steps. It also
//! keeps the verdict if a violation at a step already shows after only those steps on which it depends, because every such
//! prefix of a run is explored, too. A loss happens at the last moment before a tick. A crash, a restart and the end of
//! faults are barriers: after them all nodes are open.

use super::{Action, World, small};
use crate::scenario::Watch;

impl World {
    /// Whether the search lets the nodes take turns: of steps at different nodes that do not influence each other it explores
    /// one order only.
    pub(super) fn takes_turns(&self) -> bool {
        // The property `Stale` depends on what another node knows when a message is handed over, so for this property the
        // order of steps matters.
        self.scenario.reductions.turns && self.scenario.delay.is_some() && self.scenario.watch != Watch::Stale
    }

    /// Lists the enabled transitions: first the steps of each node, each of which closes every node before it in the order;
    /// then the transitions that need all nodes closed.
    pub(super) fn actions_in_turns(&self, actions: &mut Vec<Action>) {
        for &i in &self.order {
            self.events(i, actions);
        }
        self.crashes(actions);
        let may_heal = matches!(self.scenario.watch, Watch::MeetAgain { .. });
        let delay = self.scenario.delay.unwrap_or(0);
        let mut overdue = 0;
        let before = actions.len();
        for (at, carried) in self.in_flight.iter().enumerate() {
            overdue += usize::from(carried.age >= delay);
            let again = at > 0 && self.in_flight[at - 1] == *carried;
            // If the faults may end, a packet of any age may be lost just before the faults end.
            if self.loss > 0 && !self.healed && !again && (may_heal || carried.age >= delay) {
                actions.push(Action::Lose(small(at)));
            }
        }
        if !may_heal && overdue > 0 {
            // All overdue packets must be lost before time passes. One order of these losses is enough.
            let enough = overdue <= usize::from(self.loss);
            actions.truncate(before + usize::from(enough));
        }
        if overdue == 0 && !self.is_urgent() {
            self.ticks(actions);
        }
    }

    /// Lists the steps of node `i` in its turn.
    fn events(&self, i: usize, actions: &mut Vec<Action>) {
        let open = self.open[i];
        if open {
            self.task_actions(i, actions);
        }
        for (at, carried) in self.in_flight.iter().enumerate() {
            let here = carried.packet.destination.index() == i && (open || carried.fresh);
            if here && !(at > 0 && self.in_flight[at - 1] == *carried) {
                self.arrivals(small(at), actions);
            }
        }
    }

    /// Ends the turn of node `i`.
    fn close(&mut self, i: usize) {
        self.open[i] = false;
        self.settle_in_flight(i);
    }

    /// Closes and opens nodes as `action` requires, before it is carried out.
    pub(super) fn take_turn(&mut self, action: Action) {
        let at = match action {
            Action::Act(i) | Action::Answer(i) => usize::from(i),
            Action::Deliver(i) | Action::Overcharge(i, _) | Action::Duplicate(i) => {
                self.in_flight[usize::from(i)].packet.destination.index()
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
            self.settle_in_flight(at);
        }
    }

    /// Clears the marks of the reduction by turns. For tests.
    pub fn forget_turns(&mut self) {
        self.set_open(false);
    }

    fn set_open(&mut self, open: bool) {
        self.open.fill(open);
        self.in_flight.iter_mut().for_each(|carried| carried.fresh = false);
    }

    fn settle_in_flight(&mut self, to: usize) {
        let here = self.in_flight.iter_mut().filter(|carried| carried.packet.destination.index() == to);
        here.for_each(|carried| carried.fresh = false);
    }

    /// Makes the turns canonical: a node with nothing to do counts as closed, and a node that has only fresh packets to
    /// take counts as open.
    pub(super) fn tidy_turns(&mut self) {
        if !self.takes_turns() {
            return;
        }
        for i in 0..self.n() {
            let here = || self.in_flight.iter().filter(|carried| carried.packet.destination.index() == i);
            let mut acts = Vec::new();
            self.task_actions(i, &mut acts);
            let (any, refused) = (here().next().is_some(), here().any(|carried| !carried.fresh));
            if !any && acts.is_empty() {
                self.open[i] = false;
            } else if any && !refused && acts.is_empty() && !self.open[i] {
                self.open[i] = true;
                self.settle_in_flight(i);
            }
        }
    }
}
