//! Holds back the scripts of a restarted node (D94, D157). A cell state has one number for each node: the ticks until the
//! last of the node's scripts begins. From this number and the table follows when each other script begins.

use super::{RunState, bit};
use crate::state::Violation;
use imrs_protocol::{TaskId, Walk};

/// The scripts of a node that begin in this tick: those that are held back for a time in `from..to`, of which `begun` have
/// begun.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::cell) struct Begins {
    from: u32,
    to: u32,
    begun: u8,
}

impl Begins {
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self { from, to, begun } = self;
        w.number(from);
        w.number(to);
        w.byte(begun);
    }
}

impl RunState {
    /// Prepares a restarted node's scripts: scripts that are not held back begin in this tick, the other scripts later.
    pub fn begin_again(&mut self, node: usize) {
        self.beside.held_back[node] = Some(self.longest_held(node)).filter(|longest| *longest > 0);
        self.beside.begins[node] = Begins { from: 0, to: 1, begun: 0 };
        self.end_beginning(node);
    }

    /// Ticks until the next script of a node begins that is held back.
    pub fn next_begin(&self, node: usize) -> Option<u64> {
        let passed = self.longest_held(node) - self.beside.held_back[node]?;
        let later = self.here(node).map(|task| self.held(task)).filter(|held| *held > passed);
        later.min().map(|held| u64::from(held - passed))
    }

    /// Lets time pass for the scripts that a node holds back. Each script whose hold ends begins by a move of its own.
    pub fn hold_back_on(&mut self, node: usize, ticks: u32) {
        let Some(left) = self.beside.held_back[node] else { return };
        let longest = self.longest_held(node);
        let (before, passed) = (longest - left, longest - left.saturating_sub(ticks));
        self.beside.begins[node] = Begins { from: before + 1, to: passed + 1, begun: 0 };
        if self.begins_next(node).is_some() {
            self.beside.acted |= bit(node);
        }
        self.end_beginning(node);
    }

    /// The next task of a node whose script begins in this tick.
    pub fn begins_next(&self, node: usize) -> Option<usize> {
        let Begins { from, to, begun } = self.beside.begins[node];
        // In most states no script of the node begins. This quick test comes first, because `moves` calls this function for
        // each node in each state.
        if from == to {
            return None;
        }
        self.here(node).filter(|&task| (from..to).contains(&self.held(task))).nth(usize::from(begun))
    }

    /// Whether the script that [`begins_next`](Self::begins_next) names may begin now: the script's task must have noticed
    /// the time first.
    pub fn may_begin(&self, node: usize) -> bool {
        self.begins_next(node).is_some_and(|task| self.cell.notices_all(node, task))
    }

    /// Begins the next script of a node, with all that follows from it within the node.
    pub fn begin_next(&mut self, node: usize) -> Result<(), Violation> {
        let Some(task) = self.begins_next(node) else { return Ok(()) };
        self.beside.begins[node].begun += 1;
        self.end_beginning(node);
        self.cell.begin_whole(task)
    }

    /// Updates the state of a node's held-back scripts when the last script of this tick has begun.
    fn end_beginning(&mut self, node: usize) {
        if self.begins_next(node).is_none() {
            let passed = std::mem::take(&mut self.beside.begins[node]).to.saturating_sub(1);
            let longest = self.longest_held(node);
            self.beside.held_back[node] = Some(longest.saturating_sub(passed)).filter(|left| *left > 0);
        }
    }

    fn longest_held(&self, node: usize) -> u32 {
        self.here(node).map(|task| self.held(task)).max().unwrap_or(0)
    }

    fn held(&self, task: usize) -> u32 {
        u32::try_from(self.plan.table.held_back(TaskId::from_index(task)).0).unwrap_or(u32::MAX)
    }

    fn here(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.cell.bodies.len()).filter(move |&task| self.cell.node_state_of(task) == node)
    }
}
