//! Scripts that are held back after a restart (D94, D157). A state has one number for each node: how long until the last of
//! its scripts begins. From that and the table follows when each of the others does.

use super::{Course, bit};
use crate::state::Violation;
use imrs_protocol::TaskId;

impl Course {
    /// A node came back: those scripts begin that are not held back.
    pub fn begin_again(&mut self, node: usize) -> Result<(), Violation> {
        self.beside.held_back[node] = Some(self.longest_held(node)).filter(|longest| *longest > 0);
        self.begin_held(node, |held| held == 0)
    }

    /// In how many ticks the next script of a node begins that is held back.
    pub fn next_begin(&self, node: usize) -> Option<u64> {
        let passed = self.longest_held(node) - self.beside.held_back[node]?;
        let later = self.here(node).map(|task| self.held(task)).filter(|held| *held > passed);
        later.min().map(|held| u64::from(held - passed))
    }

    /// So many ticks pass for a node. Scripts that may begin by then do so by a step of their own.
    pub fn hold_back_on(&mut self, node: usize, ticks: u32) {
        let Some(left) = self.beside.held_back[node] else { return };
        let longest = self.longest_held(node);
        let (before, passed) = (longest - left, longest - left.saturating_sub(ticks));
        let held = |task| before < self.held(task) && self.held(task) <= passed;
        if self.here(node).any(held) {
            self.beside.begins[node] = ticks;
            self.beside.acted |= bit(node);
        } else {
            self.beside.held_back[node] = Some(longest - passed).filter(|left| *left > 0);
        }
    }

    /// Whether scripts of a node are to begin in this tick.
    pub fn begins_now(&self, node: usize) -> bool {
        self.beside.begins[node] > 0
    }

    /// Whether they may: no task of theirs has something to notice before that.
    pub fn may_begin(&self, node: usize) -> bool {
        self.begins_now(node) && self.here(node).all(|task| self.floor.notices_all(node, task))
    }

    /// The scripts of a node begin that were held back until now.
    pub fn begin_now(&mut self, node: usize) -> Result<(), Violation> {
        let ticks = std::mem::take(&mut self.beside.begins[node]);
        let Some(left) = self.beside.held_back[node] else { return Ok(()) };
        let (longest, after) = (self.longest_held(node), left.saturating_sub(ticks));
        self.beside.held_back[node] = Some(after).filter(|after| *after > 0);
        let (before, passed) = (longest - left, longest - after);
        self.begin_held(node, |held| before < held && held <= passed)
    }

    /// Begins the scripts of a node that are held back for so long, one after the other, each with what it brings about.
    fn begin_held(&mut self, node: usize, due: impl Fn(u32) -> bool) -> Result<(), Violation> {
        let tasks: Vec<usize> = self.here(node).filter(|&task| due(self.held(task))).collect();
        tasks.into_iter().try_for_each(|task| self.floor.begin_whole(task))
    }

    fn longest_held(&self, node: usize) -> u32 {
        self.here(node).map(|task| self.held(task)).max().unwrap_or(0)
    }

    fn held(&self, task: usize) -> u32 {
        u32::try_from(self.plan.table.held_back(TaskId::from_index(task)).0).unwrap_or(u32::MAX)
    }

    fn here(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.floor.bodies.len()).filter(move |&task| self.floor.station_of(task) == node)
    }
}
