//! For which tasks somebody vouches. A node tells what its tasks do; once it is dead or silent, the commands of its actions may go on until
//! their guards have confirmed the end (D142).

use imrs_protocol::{NodeId, TaskId};
use std::collections::BTreeMap;

/// Which nodes are down, and which commands run.
#[derive(Clone, Debug)]
pub struct Vouched {
    /// By node, whether it is silent or dead.
    down: Vec<bool>,
    /// The commands of tasks that answer for them, by key.
    running: BTreeMap<String, TaskId>,
    /// Commands for which no task answers any more.
    orphans: BTreeMap<String, TaskId>,
}

/// What happened to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// A node starts it for this task.
    Began(TaskId),
    /// All of it has ended.
    Ended,
    /// Its guard died, and it may go on.
    Lost,
}

/// Why nobody vouches for a task. The first reason is told where there are several.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Doubt {
    /// A command of it was not confirmed to have ended.
    Command(TaskId),
    /// Its node told nothing.
    Silent(NodeId),
    /// Its live node lost some of what it should have told.
    Untold(NodeId),
    /// Changes were dropped, because too many waited to be judged.
    Dropped,
    /// Its node is dead, and a value depends on what the others did since.
    Dead(NodeId),
}

impl Doubt {
    /// Whether nothing that comes later makes up for it.
    pub const fn lasts(self) -> bool {
        matches!(self, Self::Untold(_) | Self::Dropped | Self::Dead(_))
    }
}

impl Vouched {
    /// So many nodes, all of which tell what their tasks do.
    pub fn new(nodes: usize) -> Self {
        Self { down: vec![false; nodes], running: BTreeMap::new(), orphans: BTreeMap::new() }
    }

    /// Something happened to a command; `node` says on which node a task is.
    pub fn command(&mut self, key: String, fate: &Fate, node: impl Fn(TaskId) -> Option<NodeId>) {
        match *fate {
            Fate::Began(task) if node(task).is_some_and(|node| self.is_down(node)) => {
                self.orphans.insert(key, task);
            }
            Fate::Began(task) => {
                self.running.insert(key, task);
            }
            Fate::Ended => {
                self.running.remove(&key);
                self.orphans.remove(&key);
            }
            Fate::Lost => {
                if let Some(task) = self.running.remove(&key) {
                    self.orphans.insert(key, task);
                }
            }
        }
    }

    /// From now on the node of these tasks tells nothing, or it is dead.
    pub fn silent(&mut self, node: NodeId, tasks: impl Iterator<Item = TaskId>) {
        self.set(node, true);
        tasks.for_each(|task| self.inactive(task));
    }

    /// The task may no longer act: it does not answer for its commands any more.
    pub fn inactive(&mut self, task: TaskId) {
        let orphans = self.running.extract_if(.., |_, of| *of == task);
        self.orphans.extend(orphans);
    }

    /// The node tells what its tasks do again. The commands of its earlier incarnation may still run.
    pub fn back(&mut self, node: NodeId) {
        self.set(node, false);
    }

    fn set(&mut self, node: NodeId, is_down: bool) {
        if let Some(of) = self.down.get_mut(node.index()) {
            *of = is_down;
        }
    }

    fn is_down(&self, node: NodeId) -> bool {
        self.down.get(node.index()) == Some(&true)
    }

    /// Whether a command of this task may go on for which no task answers.
    pub fn has_orphan(&self, task: TaskId) -> bool {
        self.orphans.values().any(|of| *of == task)
    }
}
