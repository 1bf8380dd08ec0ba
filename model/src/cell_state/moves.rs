//! The enabled transitions of a cell state.

use super::plan::Transfer;
use super::{CellState, InFlight, Move, small};
use imrs_protocol::Ticks;

impl CellState {
    /// Lists the enabled transitions. Their order decides which of several shortest counterexamples is found.
    pub fn moves(&self, moves: &mut Vec<Move>) {
        if self.violation.is_some() {
            return;
        }
        let forced = self.forced();
        if !forced.is_empty() {
            for task in forced {
                self.go_on(task, moves);
            }
            return;
        }
        let busy = |i: usize| self.is_busy(i);
        for i in (0..self.nodes.len()).filter(|&i| busy(i)) {
            moves.extend(self.next_inputs(i).map(|at| Move::Take(small(i), small(at))));
        }
        for task in 0..self.bodies.len() {
            let at = self.node_state_of(task);
            if self.nodes[at].up && self.notices_all(at, task) {
                self.go_on(task, moves);
            }
        }
        self.packet_moves(moves);
        self.node_moves(moves);
        let arrived =
            self.in_flight.iter().all(|c| c.age < Ticks(u64::from(self.links[usize::from(c.link)].2)));
        if arrived && !(0..self.nodes.len()).any(busy) {
            self.ticks(moves);
        }
    }

    fn go_on(&self, task: usize, moves: &mut Vec<Move>) {
        let (body, plan) = (&self.bodies[task], &self.plan.tasks[task]);
        if let Some(actor) = &body.actor {
            let choices = 0..actor.chooses().unwrap_or(0);
            moves.extend(choices.map(|k| Move::Choose(small(task), small(usize::from(k)))));
            let may = actor.running.iter().filter(|action| action.least.is_zero());
            moves.extend(may.map(|action| Move::Acted(small(task), action.level)));
            return;
        }
        if self.may_act(task) {
            moves.push(Move::Act(small(task)));
        }
        if body.may_nest(plan) {
            moves.push(Move::Nest(small(task)));
        }
    }

    /// The tasks that must step before anything else may happen.
    pub(super) fn forced(&self) -> Vec<usize> {
        let must = |&task: &usize| {
            let node_state = &self.nodes[self.node_state_of(task)];
            node_state.up && !node_state.node.is_busy() && self.bodies[task].must_act(&self.plan.tasks[task])
        };
        (0..self.bodies.len()).filter(must).collect()
    }

    fn packet_moves(&self, moves: &mut Vec<Move>) {
        for (i, carried) in self.in_flight.iter().enumerate() {
            let same = |other: &InFlight| other.link == carried.link;
            let bound = Ticks(u64::from(self.links[usize::from(carried.link)].2));
            let at_its_end = carried.age >= bound;
            match self.plan.transfer {
                // Delivering one of two equal packets gives the same state as delivering the other.
                Transfer::Any if i > 0 && self.in_flight[i - 1] == *carried => continue,
                Transfer::Exact if !at_its_end || self.in_flight[..i].iter().any(same) => continue,
                Transfer::Any | Transfer::Exact => {}
            }
            let i = small(i);
            moves.push(Move::Deliver(i, 0));
            if self.faults.over > 0 {
                moves.push(Move::Deliver(i, 1));
            }
            // No task can notice the loss of a packet before the last tick at which the packet could arrive.
            if self.faults.loss > 0 && at_its_end {
                moves.push(Move::Lose(i));
            }
            if self.faults.dup > 0 {
                moves.push(Move::Duplicate(i));
            }
        }
    }

    fn node_moves(&self, moves: &mut Vec<Move>) {
        for (i, node_state) in self.nodes.iter().enumerate() {
            if !node_state.up {
                moves.push(Move::Restart(small(i)));
            } else if self.faults.crash > 0 && !node_state.node.is_busy() {
                moves.push(Move::Crash(small(i)));
            }
        }
    }
}
