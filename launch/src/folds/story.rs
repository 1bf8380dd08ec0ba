//! The story of a run, for an explanation of its outcome: what the scripts did, and which faults were injected.

use super::summary::Summary;
use crate::cells::Loaded;
use crate::fact::{Fact, Fold};
use crate::faults::Fault;
use crate::pipe::Word;
use crate::script_event::{Did, ScriptEvent};
use imrs_protocol::{NodeId, TaskId};

/// The greatest number of events that are kept for the story; later events are left out.
const LONGEST: usize = 100_000;

/// The events that are kept of a run for its story.
#[derive(Default)]
pub struct Events {
    began: u64,
    ended: Option<u64>,
    scripts: Vec<Did>,
    faults: Vec<(u64, Fault)>,
}

impl Fold for Events {
    fn take(&mut self, at: u64, fact: &Fact) {
        match fact {
            Fact::Began => self.began = at,
            Fact::Said(_, Word::Did(did)) if self.ended.is_none() && self.scripts.len() < LONGEST => {
                self.scripts.push(did.clone());
            }
            Fact::Fault(fault) => self.faults.push((at, *fault)),
            Fact::Over => self.ended = Some(at),
            _ => {}
        }
    }
}

impl Events {
    /// The story of the finished run with this summary.
    pub fn story<'a>(mut self, loaded: &'a Loaded, summary: &'a Summary) -> Story<'a> {
        self.scripts.sort_by_key(|did| did.at);
        let Self { began, ended, scripts: events, faults } = self;
        Story { loaded, began, ended: ended.unwrap_or(u64::MAX), events, faults, summary }
    }
}

/// A finished run, with the data for its explanation.
pub struct Story<'a> {
    /// The cell that ran.
    pub loaded: &'a Loaded,
    /// When the tasks began, in microseconds of the clock that all processes of one machine share.
    pub began: u64,
    /// When the tasks were stopped, in microseconds of the same clock.
    pub ended: u64,
    /// The events of the scripts, by time.
    pub events: Vec<Did>,
    /// The injected faults, by time.
    pub faults: Vec<(u64, Fault)>,
    /// The summary of the run.
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

    /// The events of a task, by time.
    pub fn of(&self, task: TaskId) -> impl DoubleEndedIterator<Item = &Did> {
        self.events.iter().filter(move |did| did.task == task)
    }

    /// An instant, counted from the beginning of the run: `1.234 s`.
    pub fn at(&self, at: u64) -> String {
        let ms = at.saturating_sub(self.began) / 1_000;
        format!("{}.{:03} s", ms / 1_000, ms % 1_000)
    }

    /// When the node of a task was last killed; `None` if it was never killed, or has been restarted since.
    pub fn died(&self, task: TaskId) -> Option<u64> {
        let node = self.loaded.table.location(task)?;
        let of_it = self
            .faults
            .iter()
            .rev()
            .find(|(_, fault)| matches!(fault, Fault::Kill(of) | Fault::Restart(of) if *of == node))?;
        matches!(of_it.1, Fault::Kill(_)).then_some(of_it.0)
    }

    /// Every time at which the node of a task was killed.
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

    /// The first node that was suspended, and when the suspension began and ended.
    pub fn pause(&self) -> Option<(NodeId, u64, u64)> {
        let (at, node) = self.faults.iter().find_map(|(at, fault)| match fault {
            Fault::Pause(node) => Some((*at, *node)),
            Fault::Kill(_) | Fault::Restart(_) | Fault::Cut(..) | Fault::Heal(..) | Fault::Resume(_) => None,
        })?;
        let on = self.faults.iter().find(|(_, fault)| *fault == Fault::Resume(node));
        Some((node, at, on.map_or(self.ended, |(on, _)| *on)))
    }

    /// The first line of the handler in which an event happened; empty if the event happened in the body of its task.
    pub fn handler(&self, did: &Did) -> &str {
        let head = did.line.and_then(|line| self.loaded.handler(did.task, line));
        head.map_or("", |head| self.loaded.text_of(head))
    }

    /// The times of those events of a task for which `is` returns true.
    pub fn when(&self, task: TaskId, is: impl Fn(&ScriptEvent) -> bool) -> Vec<u64> {
        self.of(task).filter(|did| is(&did.what)).map(|did| did.at).collect()
    }
}
