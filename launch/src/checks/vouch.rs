//! Tracks which tasks may act although no node reports it. A node reports what its tasks do. Once the node is dead or
//! silent, the commands of its actions may go on until their guards confirm the end (D142).

use imrs_protocol::{NodeId, TaskId};
use std::collections::BTreeMap;

/// Which nodes are down, and which commands of actions run.
#[derive(Clone, Debug)]
pub struct Vouched {
    /// For each node, whether it is silent or dead.
    down: Vec<bool>,
    /// Running commands that their tasks still control: the task of each key.
    running: BTreeMap<String, TaskId>,
    /// Running commands that no task controls any more: the task of each key.
    orphans: BTreeMap<String, TaskId>,
}

/// An event of a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CommandEvent {
    /// A node starts the command for this task.
    Began(TaskId),
    /// The command, and every process that it started, has ended.
    Ended,
    /// The command's guard died, so the command may still run.
    Lost,
}

/// Why values of a task are not known. If several reasons apply, the first one is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Doubt {
    /// The end of a command of this task was not confirmed.
    Command(TaskId),
    /// The task's node reported nothing.
    Silent(NodeId),
    /// The task's node runs, but could not report some events.
    Untold(NodeId),
    /// The judge dropped changes, because too many waited to be judged.
    Dropped,
    /// The task's node is dead, and a value depends on what other tasks have done since its death.
    Dead(NodeId),
}

impl Doubt {
    /// Whether no later report can resolve this doubt.
    pub const fn lasts(self) -> bool {
        matches!(self, Self::Untold(_) | Self::Dropped | Self::Dead(_))
    }
}

impl Vouched {
    /// Makes the state for this many nodes, all of which report what their tasks do.
    pub fn new(nodes: usize) -> Self {
        Self { down: vec![false; nodes], running: BTreeMap::new(), orphans: BTreeMap::new() }
    }

    /// Takes an event of a command. `node` returns the node of a task.
    pub fn command(&mut self, key: String, event: &CommandEvent, node: impl Fn(TaskId) -> Option<NodeId>) {
        match *event {
            CommandEvent::Began(task) if node(task).is_some_and(|node| self.is_down(node)) => {
                self.orphans.insert(key, task);
            }
            CommandEvent::Began(task) => {
                self.running.insert(key, task);
            }
            CommandEvent::Ended => {
                self.running.remove(&key);
                self.orphans.remove(&key);
            }
            CommandEvent::Lost => {
                if let Some(task) = self.running.remove(&key) {
                    self.orphans.insert(key, task);
                }
            }
        }
    }

    /// Notes that from now on this node, with these tasks, is silent or dead.
    pub fn silent(&mut self, node: NodeId, tasks: impl Iterator<Item = TaskId>) {
        self.set(node, true);
        tasks.for_each(|task| self.inactive(task));
    }

    /// Notes that the task may not act any more, so that it does not control its commands any more.
    pub fn inactive(&mut self, task: TaskId) {
        let orphans = self.running.extract_if(.., |_, of| *of == task);
        self.orphans.extend(orphans);
    }

    /// Notes that the node reports again. Commands of its earlier incarnation may still run.
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

    /// Whether a command of this task may still run that no task controls.
    pub fn has_orphan(&self, task: TaskId) -> bool {
        self.orphans.values().any(|of| *of == task)
    }
}
