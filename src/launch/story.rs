//! What a demo tells: a fault that comes when the cell is at a certain point, and what came of it, in words.

use super::deed::{Deed, Did};
use super::faults::Fault;
pub use super::summary::Outcome;
use super::summary::Summary;
use crate::cells::Loaded;
use imrs_protocol::{NodeId, TaskId};
use std::time::Duration;

/// What a demo adds to a run.
#[derive(Clone, Copy, Debug)]
pub struct Tale {
    /// What a person should know before.
    pub introduction: &'static str,
    /// The fault that is injected, if any.
    pub moment: Option<&'static Moment>,
    /// Says what happened, and whether it was what is promised.
    pub explain: fn(&Story<'_>) -> Outcome,
}

/// A fault that waits for the cell to come to a certain point.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// It comes so long after
    pub after: Duration,
    /// this task
    pub task: &'static str,
    /// has begun this action
    pub action: &'static str,
    /// for this time, from 1.
    pub time: usize,
    /// What happens.
    pub fault: Planned,
    /// All this in words.
    pub words: &'static str,
}

/// A fault by the names of the cell.
#[derive(Clone, Copy, Debug)]
pub enum Planned {
    /// The link between two nodes carries nothing for so long.
    Cut([&'static str; 2], Duration),
    /// The node is killed.
    Kill(&'static str),
    /// The node stands still for so long (SIGSTOP); one that shares its process with others is cut off from them in place of that.
    Pause(&'static str, Duration),
}

/// A run, to be explained.
pub struct Story<'a> {
    /// The cell.
    pub loaded: &'a Loaded,
    /// When its tasks began, on the clock that all processes of one machine share, in microseconds.
    pub began: u64,
    /// When they were stopped.
    pub ended: u64,
    /// What the scripts did, by time.
    pub deeds: Vec<Did>,
    /// The faults, by time.
    pub faults: Vec<(u64, Fault)>,
    /// The figures.
    pub summary: &'a Summary,
}

impl Story<'_> {
    /// The task of this name.
    pub fn task(&self, name: &str) -> Option<TaskId> {
        let tasks = &self.loaded.table.cell().tasks;
        tasks.iter().position(|task| task.name == name).map(TaskId::from_index)
    }

    /// The name of a task.
    pub fn name(&self, task: TaskId) -> &str {
        self.loaded.table.cell().tasks.get(task.index()).map_or("?", |task| &task.name)
    }

    /// The name of a node.
    pub fn node(&self, node: NodeId) -> &str {
        self.loaded.table.cell().nodes.get(node.index()).map_or("?", |node| &node.name)
    }

    /// What a task did, by time.
    pub fn of(&self, task: TaskId) -> impl DoubleEndedIterator<Item = &Did> {
        self.deeds.iter().filter(move |did| did.task == task)
    }

    /// An instant, counted from the beginning: `1.234 s`.
    pub fn at(&self, at: u64) -> String {
        let ms = at.saturating_sub(self.began) / 1_000;
        format!("{}.{:03} s", ms / 1_000, ms % 1_000)
    }

    /// When the node of a task was killed, if it was, and was not started again.
    pub fn died(&self, task: TaskId) -> Option<u64> {
        let node = self.loaded.table.location(task)?;
        let of_it = self
            .faults
            .iter()
            .rev()
            .find(|(_, fault)| matches!(fault, Fault::Kill(of) | Fault::Restart(of) if *of == node))?;
        matches!(of_it.1, Fault::Kill(_)).then_some(of_it.0)
    }

    /// When the node of a task was killed, each time.
    pub fn deaths(&self, task: TaskId) -> Vec<u64> {
        let node = self.loaded.table.location(task);
        let kill = |(at, fault): &(u64, Fault)| match fault {
            Fault::Kill(of) if Some(*of) == node => Some(*at),
            Fault::Kill(_)
            | Fault::Restart(_)
            | Fault::Cut(..)
            | Fault::Heal(..)
            | Fault::Pause(_)
            | Fault::Resume(_) => None,
        };
        self.faults.iter().filter_map(kill).collect()
    }

    /// When a node first stood still, and when it went on.
    pub fn pause(&self) -> Option<(NodeId, u64, u64)> {
        let (at, node) = self.faults.iter().find_map(|(at, fault)| match fault {
            Fault::Pause(node) => Some((*at, *node)),
            Fault::Kill(_) | Fault::Restart(_) | Fault::Cut(..) | Fault::Heal(..) | Fault::Resume(_) => None,
        })?;
        let on = self.faults.iter().find(|(_, fault)| *fault == Fault::Resume(node));
        Some((node, at, on.map_or(self.ended, |(on, _)| *on)))
    }

    /// The text of the line of a deed.
    pub fn text(&self, did: &Did) -> &str {
        did.line.map_or("", |line| self.loaded.text_of(line))
    }

    /// When a task did this, each time.
    pub fn when(&self, task: TaskId, is: impl Fn(&Deed) -> bool) -> Vec<u64> {
        self.of(task).filter(|did| is(&did.what)).map(|did| did.at).collect()
    }
}
