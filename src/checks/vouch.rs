//! For which tasks somebody vouches. A node tells what its tasks do; once it is dead or silent, the commands of its actions may go on until
//! their guards have confirmed the end (D142).

use imrs_protocol::{NodeId, TaskId};
use std::collections::BTreeMap;

/// What is known of nodes that tell nothing, and of commands.
#[derive(Clone, Debug)]
pub struct Vouched {
    nodes: Vec<Silence>,
    /// The commands of live nodes, by key.
    running: BTreeMap<String, TaskId>,
    /// Commands for which no node answers any more.
    orphans: BTreeMap<String, TaskId>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Silence {
    /// It tells what its tasks do.
    None,
    /// It does not, and it may still run.
    Silent,
    /// It is dead: its scripts do nothing.
    Dead,
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

/// Why nobody vouches for a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Doubt {
    /// A command of it was not confirmed to have ended.
    Command(TaskId),
    /// Its node told nothing.
    Silent(NodeId),
}

impl Vouched {
    /// So many nodes, all of which tell what their tasks do.
    pub fn new(nodes: usize) -> Self {
        Self { nodes: vec![Silence::None; nodes], running: BTreeMap::new(), orphans: BTreeMap::new() }
    }

    /// Something happened to a command; `node` says on which node a task is.
    pub fn command(&mut self, key: String, fate: Fate, node: impl Fn(TaskId) -> Option<NodeId>) {
        match fate {
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

    /// From now on the node of these tasks tells nothing.
    pub fn silent(&mut self, node: NodeId, tasks: impl Iterator<Item = TaskId>) {
        self.set(node, Silence::Silent);
        let tasks: Vec<TaskId> = tasks.collect();
        let orphans = self.running.extract_if(.., |_, task| tasks.contains(task));
        self.orphans.extend(orphans);
    }

    /// The node of these tasks is dead.
    pub fn dead(&mut self, node: NodeId, tasks: impl Iterator<Item = TaskId>) {
        self.silent(node, tasks);
        self.set(node, Silence::Dead);
    }

    /// The node tells what its tasks do again. The commands of its earlier incarnation may still run.
    pub fn back(&mut self, node: NodeId) {
        self.set(node, Silence::None);
    }

    fn set(&mut self, node: NodeId, silence: Silence) {
        if let Some(of) = self.nodes.get_mut(node.index()) {
            *of = silence;
        }
    }

    fn is_down(&self, node: NodeId) -> bool {
        self.nodes.get(node.index()).is_some_and(|of| *of != Silence::None)
    }

    /// Why nobody vouches for a task on this node, if so.
    pub fn doubt(&self, task: TaskId, node: NodeId) -> Option<Doubt> {
        if self.orphans.values().any(|of| *of == task) {
            return Some(Doubt::Command(task));
        }
        let is_silent = self.nodes.get(node.index()) == Some(&Silence::Silent);
        is_silent.then_some(Doubt::Silent(node))
    }
}
