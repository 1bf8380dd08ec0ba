//! Scripts that are held back after a restart (D94, D157). A state has one number for each node: how long until the last of
//! its scripts begins. From that and the table follows when each of the others does.

use super::{Course, bit};
use crate::state::Violation;
use imrs_protocol::TaskId;

impl Course {
    /// A node came back: those scripts begin that are not held back.
    pub fn begin_again(&mut self, node: usize) -> Result<(), Violation> {
        self.beside.held_back[node] = Some(self.longest_held(node)).filter(|longest| *longest > 0);
        self.begin_held(node, |held| held == 0).map(drop)
    }

    /// In how many ticks the next script of a node begins that is held back.
    pub fn next_begin(&self, node: usize) -> Option<u64> {
        let passed = self.longest_held(node) - self.beside.held_back[node]?;
        let later = self.here(node).map(|task| self.held(task)).filter(|held| *held > passed);
        later.min().map(|held| u64::from(held - passed))
    }

    /// So many ticks pass for a node.
    pub fn hold_back_on(&mut self, node: usize, ticks: u32) -> Result<(), Violation> {
        let Some(left) = self.beside.held_back[node] else { return Ok(()) };
        let (longest, after) = (self.longest_held(node), left.saturating_sub(ticks));
        self.beside.held_back[node] = Some(after).filter(|after| *after > 0);
        let (before, passed) = (longest - left, longest - after);
        if self.begin_held(node, |held| before < held && held <= passed)? {
            self.beside.acted |= bit(node);
        }
        Ok(())
    }

    /// Begins the scripts of a node that are held back for so long. Whether there are any.
    fn begin_held(&mut self, node: usize, due: impl Fn(u32) -> bool) -> Result<bool, Violation> {
        let tasks: Vec<usize> = self.here(node).filter(|&task| due(self.held(task))).collect();
        let any = !tasks.is_empty();
        tasks.into_iter().try_for_each(|task| self.floor.begin(task))?;
        Ok(any)
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
