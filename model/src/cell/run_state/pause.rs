//! Pauses: for a while a node takes no step, as when its process is stopped (SIGSTOP), frozen, or not scheduled.
//!
//! ```text
//!   a step is due at the node --Pause--> asleep: packets wait at the end of their links, actions go on, nothing is noticed
//!                                           |
//!                                          Wake: time first (all of it at once: leases and deadlines), then what waits,
//!                                                charged with its wait; then actions that ended meanwhile
//! ```
//!
//! A pause begins right before a step of its node. An earlier start, back to the node's last step, looks the same to all
//! other nodes, and the latest start allows the longest pause. The pause ends after any event of the cell, at the node's
//! own next deadline or end of lease, or at its bound.
//!
//! An action of a paused node goes on by itself. An action that began in the tick of the pause may also begin only after
//! the pause, if the process was stopped between the decision and the command. The lease of a paused task ends on time,
//! because the robot's driver stops the action then (D149). From that instant the task does not act, although the task does
//! not know that yet.

use super::{CellMove, RunState, bit, small};
use crate::cell::plan::Pause;
use crate::cell_state::CellState;
use crate::cell_state::script::{Actor, Running};
use crate::state::Violation;
use imrs_protocol::Ticks;
use imrs_protocol::script::Op;

/// A paused node. The cell state counts how long the pause has lasted: [`NodeState::asleep`](crate::cell_state::NodeState::asleep).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::cell) struct Asleep {
    /// Ticks that the pause may still last.
    pub left: u32,
    /// Actions that begin only when the node wakes: task and activation.
    pub held: Vec<(u8, u8)>,
}

impl CellState {
    /// Ticks since the node's pause began; `None` if the node is not paused.
    pub(in crate::cell) fn slept(&self, node: usize) -> Option<u32> {
        self.nodes[node].asleep
    }
}

impl RunState {
    pub fn is_asleep(&self, node: usize) -> bool {
        self.beside.asleep[node].is_some()
    }

    /// Whether the pause of a node has reached its bound.
    pub fn must_wake(&self, node: usize) -> bool {
        self.beside.asleep[node].as_ref().is_some_and(|asleep| asleep.left == 0)
    }

    /// The numbers of the unused pauses that may begin at a node. Of several equal pauses only the first is listed.
    fn unused(&self, node: usize) -> impl Iterator<Item = u8> {
        let all = || self.faults.pause.iter().zip(&self.beside.paused);
        let unused = move |&(at, (pause, &left)): &(usize, (&Pause, &u8))| {
            left > 0 && pause.is_of(node) && !all().take(at).any(|(other, &left)| left > 0 && other == pause)
        };
        all().enumerate().filter(unused).map(|(at, _)| small(at))
    }

    /// Adds the pauses that may begin instead of the other moves of a node in this tick.
    pub fn pauses(&self, node: usize, moves: &mut Vec<CellMove>) {
        if self.faults.pause.is_empty() || !self.cell.nodes[node].up {
            return;
        }
        moves.extend(self.unused(node).map(|number| CellMove::Pause(number, small(node))));
        self.pauses_before(node, moves);
    }

    /// Adds the pauses that hold back actions which the node has just begun.
    fn pauses_before(&self, node: usize, moves: &mut Vec<CellMove>) {
        if !self.fresh(node).is_empty() {
            moves.extend(self.unused(node).map(|number| CellMove::PauseBefore(number, small(node))));
        }
    }

    /// Adds the pauses and wake-ups that are possible when no node has anything to do in this tick.
    pub fn pauses_between(&self, moves: &mut Vec<CellMove>) {
        if self.faults.pause.is_empty() {
            return;
        }
        let next = self.next_event();
        for node in (0..self.cell.nodes.len()).filter(|&node| self.cell.nodes[node].up) {
            if self.is_asleep(node) {
                // A pause that has not lasted a tick yet cannot end.
                if self.cell.slept(node) > Some(0) {
                    moves.push(CellMove::Wake(small(node)));
                }
                continue;
            }
            let at = small(node);
            self.pauses_before(node, moves);
            if next.is_some_and(|next| self.notices(node, next)) {
                moves.extend(self.unused(node).map(|number| CellMove::PauseNext(number, at)));
            } else if self.plan.everything && next.is_some() {
                moves.extend(self.unused(node).map(|number| CellMove::Pause(number, at)));
            }
        }
    }

    /// Whether a node does something by itself within `ticks`.
    fn notices(&self, node: usize, ticks: Ticks) -> bool {
        let due = self.cell.nodes[node].node.time_left();
        let begins = self.next_begin(node);
        due.into_iter().chain(begins).any(|due| due <= ticks)
    }

    /// The actions of a node that were begun in this tick.
    fn fresh(&self, node: usize) -> Vec<(u8, u8)> {
        let cell_state = &self.cell;
        let here = (0..cell_state.bodies.len()).filter(|&task| cell_state.node_state_of(task) == node);
        let actions = here.flat_map(|task| {
            let actor = cell_state.bodies[task].actor.as_ref();
            let running =
                actor.into_iter().flat_map(|actor| actor.running.iter().map(move |one| (actor, one)));
            running
                .filter(|(actor, action)| self.has_just_begun(actor, action))
                .map(move |(_, action)| (small(task), action.level))
        });
        actions.collect()
    }

    /// Whether no tick has passed since an action began: the action's remaining times still equal those of its statement.
    fn has_just_begun(&self, actor: &Actor, running: &Running) -> bool {
        let at = actor.host.script.position_at(running.level);
        match at.and_then(|at| actor.host.program.code.get(usize::from(at))) {
            Some(&Op::Run { action, least, most, .. }) => {
                action == running.action
                    && !running.most.is_zero()
                    && (Running::length(least), Running::length(most)) == (running.least, running.most)
            }
            _ => false,
        }
    }

    /// Begins a pause of a node that holds back the actions `held`.
    pub fn fall_asleep(&mut self, number: u8, node: usize, held: Vec<(u8, u8)>) {
        let number = usize::from(number);
        self.beside.paused[number] = 0;
        self.beside.asleep[node] = Some(Asleep { left: self.faults.pause[number].most, held });
        self.cell.nodes[node].asleep = Some(0);
    }

    /// Begins a pause of a node that holds back the actions that were begun in this tick.
    pub fn fall_asleep_before(&mut self, number: u8, node: usize) {
        let held = self.fresh(node);
        self.fall_asleep(number, node, held);
    }

    /// Ends the pause of a node, because the node crashes.
    pub fn forget_pause(&mut self, node: usize) {
        self.beside.asleep[node] = None;
        self.cell.nodes[node].asleep = None;
    }

    /// Wakes a paused node. The node counts the time first, and with it its leases and deadlines; waiting packets arrive by
    /// later moves.
    pub fn wake(&mut self, node: usize) -> Result<(), Violation> {
        let slept = self.cell.slept(node).unwrap_or(0);
        self.forget_pause(node);
        self.notice(node, Ticks(slept.into()))
    }

    /// Lets time pass for a paused node.
    pub fn sleep_on(&mut self, node: usize, (ticks, counted): (Ticks, Ticks)) {
        let [ticks, counted] = [ticks, counted].map(|length| u32::try_from(length.0).unwrap_or(u32::MAX));
        if let (Some(slept), Some(asleep)) =
            (&mut self.cell.nodes[node].asleep, &mut self.beside.asleep[node])
        {
            *slept = slept.saturating_add(counted);
            asleep.left = asleep.left.saturating_sub(ticks);
        }
    }

    /// Passes `ticks` on a node's clock, and for the scripts that it holds back.
    pub fn notice(&mut self, node: usize, ticks: Ticks) -> Result<(), Violation> {
        // Each time is compared by itself: symbolic times have no values, so none of them is known to be the least.
        if self.cell.nodes[node].node.times_left().any(|due| due <= ticks) {
            self.beside.acted |= bit(node);
        }
        // If no time passes, nothing changes. The condition is not evaluated for symbolic times, so that the search
        // need not decide whether a time without a value is zero.
        if self.cell.is_symbolic || !ticks.is_zero() {
            self.cell.pass(node, ticks)?;
        }
        self.hold_back_on(node, ticks);
        Ok(())
    }

    /// Lets time pass for the actions of all nodes, paused or not, except for actions that a pause holds back.
    pub fn act_on(&mut self, ticks: Ticks) {
        for task in 0..self.cell.bodies.len() {
            let node = self.cell.node_state_of(task);
            let up = self.cell.nodes[node].up;
            let Some(actor) = self.cell.bodies[task].actor.as_mut().filter(|_| up) else { continue };
            match &self.beside.asleep[node] {
                Some(asleep) if !asleep.held.is_empty() => {
                    let begun = |level| !asleep.held.contains(&(small(task), level));
                    actor.pass_for(ticks, begun);
                }
                _ => actor.pass(ticks),
            }
        }
    }

    /// Whether an action is really running: no pause holds back its beginning.
    pub fn has_begun(&self, task: usize, level: u8) -> bool {
        let asleep = self.beside.asleep[self.cell.node_state_of(task)].as_ref();
        asleep.is_none_or(|asleep| !asleep.held.contains(&(small(task), level)))
    }

    /// Ticks until each event at which a paused node may wake: its own deadlines and ends of leases, the bound of its pause.
    pub fn events_asleep(&self, node: usize) -> impl Iterator<Item = u64> {
        let slept = u64::from(self.cell.slept(node).unwrap_or(0));
        let left = self.beside.asleep[node].as_ref().map(|asleep| asleep.left);
        let machines = &self.cell.nodes[node].node;
        let due = machines.time_left();
        let leases = machines.parts().tasks.iter().filter_map(imrs_protocol::CommTask::lease_left);
        let own = leases.chain(due).filter_map(move |due| due.0.checked_sub(slept)).filter(|left| *left > 0);
        own.chain(left.filter(|left| *left > 0).map(|left| self.to_next_step(Ticks(left.into())).0))
    }

    /// Ticks that a packet has waited at the end of its link for a paused node.
    pub fn has_waited(&self, packet: usize) -> Ticks {
        self.cell.in_flight.get(packet).map_or(Ticks::ZERO, |carried| {
            let bound = self.cell.links[usize::from(carried.link)].2;
            carried.age - Ticks(bound.into())
        })
    }

    /// The longest time that a packet has waited for a paused node. When the node wakes, it takes packets in the order in
    /// which they arrived.
    pub fn longest_wait(&self, node: usize) -> Ticks {
        if self.faults.pause.is_empty() {
            return Ticks::ZERO;
        }
        let here = (0..self.cell.in_flight.len()).filter(|&i| {
            let link = usize::from(self.cell.in_flight[i].link);
            self.cell.links[link].1.index() == node && !self.cell.is_behind(i)
        });
        here.map(|i| self.has_waited(i)).max().unwrap_or_default()
    }
}
