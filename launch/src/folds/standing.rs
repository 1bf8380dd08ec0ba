//! Which tasks of a run still run: their scripts have not ended, and their nodes are not gone.

use crate::cells::Loaded;
use crate::fact::{Fact, Fold};
use crate::faults::Fault;
use crate::pipe::Word;
use imrs_protocol::{NodeId, TaskId};

/// The tasks and nodes that have ended so far.
pub struct Standing<'a> {
    loaded: &'a Loaded,
    /// The nodes that this launcher runs.
    here: Vec<NodeId>,
    /// Tasks whose scripts have ended by themselves.
    ended: Vec<TaskId>,
    /// Nodes whose pipe has ended.
    gone: Vec<NodeId>,
}

impl Fold for Standing<'_> {
    fn take(&mut self, _at: u64, fact: &Fact) {
        match fact {
            Fact::Said(_, Word::TaskEnded { task, .. }) => self.ended.push(*task),
            Fact::Gone(node) => self.gone.push(*node),
            Fact::Fault(Fault::Restart(node)) => {
                self.gone.retain(|gone| gone != node);
                let table = &self.loaded.table;
                self.ended.retain(|task| table.location(*task) != Some(*node));
            }
            _ => {}
        }
    }
}

impl<'a> Standing<'a> {
    /// Makes the state of a run of these nodes, before any task or node has ended.
    pub const fn new(loaded: &'a Loaded, here: Vec<NodeId>) -> Self {
        Self { loaded, here, ended: Vec::new(), gone: Vec::new() }
    }

    /// Whether all nodes are gone.
    pub fn is_gone(&self) -> bool {
        self.gone.len() == self.here.len()
    }

    /// The nodes that are not gone, so that they may still report something.
    pub fn unheard(&self) -> Vec<NodeId> {
        self.here.iter().copied().filter(|node| !self.gone.contains(node)).collect()
    }

    /// Whether the run had tasks, and none of them still runs.
    pub fn has_ended(&self) -> bool {
        self.tasks().next().is_some() && self.left().next().is_none()
    }

    fn tasks(&self) -> impl Iterator<Item = TaskId> {
        self.here.iter().flat_map(|node| self.loaded.table.tasks_on(*node))
    }

    /// The tasks that still run.
    fn left(&self) -> impl Iterator<Item = TaskId> {
        let is_gone =
            |task: TaskId| self.loaded.table.location(task).is_some_and(|node| self.gone.contains(&node));
        self.tasks().filter(move |task| !self.ended.contains(task) && !is_gone(*task))
    }

    /// The tasks that still run, if all of them serve for ever and another task has ended; otherwise `None`.
    pub fn servers_left(&self) -> Option<Vec<TaskId>> {
        let finishes = |task: TaskId| self.loaded.can_finish(task);
        let is_idle = self.tasks().any(finishes) && !self.left().any(finishes);
        Some(self.left().collect()).filter(|left: &Vec<TaskId>| is_idle && !left.is_empty())
    }
}
