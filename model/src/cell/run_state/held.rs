//! Holds back the scripts of a restarted node (D94, D157). A cell state has one time for each node: how long until the last
//! of its scripts begins. The table then tells when each of the others begins.

use super::{RunState, bit};
use crate::state::Violation;
use imrs_protocol::{TaskId, Ticks};

/// No script is held back for longer: packed states have no room for it.
const LONGEST: Ticks = Ticks(u32::MAX as u64 - 4);

impl RunState {
    /// Prepares a restarted node's scripts: scripts that are not held back begin in this tick, the other scripts later.
    pub fn begin_again(&mut self, node: usize) {
        let at_once = self.here(node).filter(|&task| self.held(task).is_zero());
        self.beside.begins[node] = at_once.fold(0, |begins, task| begins | bit(task));
        self.beside.held_back[node] = Some(self.longest_held(node)).filter(|longest| !longest.is_zero());
    }

    /// The time until the next script begins that a node holds back.
    pub fn next_begin(&self, node: usize) -> Option<Ticks> {
        self.to_begin(node).map(|(_, left)| left).min()
    }

    /// The tasks of a node whose scripts are held back, and the time until each begins.
    fn to_begin(&self, node: usize) -> impl Iterator<Item = (usize, Ticks)> + '_ {
        let left = self.beside.held_back[node];
        left.into_iter().flat_map(move |left| {
            let longest = self.longest_held(node);
            let of_task = move |task| {
                // How long after this script the last script begins.
                let before_last = longest - self.held(task);
                (left > before_last).then(|| (task, left - before_last))
            };
            self.here(node).filter_map(of_task)
        })
    }

    /// Lets time pass for a node's scripts. Each script whose hold ends begins by a move of its own.
    pub fn hold_back_on(&mut self, node: usize, ticks: Ticks) {
        let Some(left) = self.beside.held_back[node] else { return };
        let begin = self.to_begin(node).filter(|(_, left)| *left <= ticks);
        let begins = begin.fold(0, |begins, (task, _)| begins | bit(task));
        if begins != 0 {
            self.beside.acted |= bit(node);
        }
        self.beside.begins[node] |= begins;
        self.beside.held_back[node] = Some(left - ticks).filter(|left| !left.is_zero());
    }

    /// The next task of a node whose script begins in this tick.
    pub fn begins_next(&self, node: usize) -> Option<usize> {
        let begins = self.beside.begins[node];
        (begins != 0).then_some(begins.trailing_zeros() as usize)
    }

    /// Whether the script that [`begins_next`](Self::begins_next) names may begin now: the script's task must have noticed
    /// the time first.
    pub fn may_begin(&self, node: usize) -> bool {
        self.begins_next(node).is_some_and(|task| self.cell.notices_all(node, task))
    }

    /// Begins the next script of a node, with all that follows from it within the node.
    pub fn begin_next(&mut self, node: usize) -> Result<(), Violation> {
        let Some(task) = self.begins_next(node) else { return Ok(()) };
        self.beside.begins[node] &= !bit(task);
        self.cell.begin_whole(task)
    }

    fn longest_held(&self, node: usize) -> Ticks {
        self.here(node).map(|task| self.held(task)).max().unwrap_or(Ticks::ZERO)
    }

    fn held(&self, task: usize) -> Ticks {
        self.plan.table.held_back(TaskId::from_index(task)).min(LONGEST)
    }

    fn here(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.cell.bodies.len()).filter(move |&task| self.cell.node_state_of(task) == node)
    }
}
