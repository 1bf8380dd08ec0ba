//! The communication tasks of a node, each behind its hand-off.

use crate::comm::Comm;
use crate::handoff::{Bell, Handoff};
use imrs_protocol::TaskId;
use imrs_wire::obs::Liveness;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// A task of the node.
pub(crate) struct Member {
    pub task: TaskId,
    pub handoff: Handoff<Comm>,
    life: AtomicU8,
    /// Whether its next wait is likely to be ended by what a link brings: what ended the last one.
    pub by_link: AtomicBool,
}

impl Member {
    /// `bell` calls the task's thread where it waits in the link.
    pub fn new(task: TaskId, comm: Comm, bell: Option<Arc<dyn Bell>>) -> Self {
        Self {
            task,
            handoff: Handoff::new(comm, bell),
            life: AtomicU8::new(Liveness::Alive as u8),
            by_link: AtomicBool::new(true),
        }
    }

    pub fn liveness(&self) -> Liveness {
        match self.life.load(Ordering::Relaxed) {
            0 => Liveness::Alive,
            1 => Liveness::Ended,
            _ => Liveness::Crashed,
        }
    }

    pub fn set_liveness(&self, liveness: Liveness) {
        self.life.store(liveness as u8, Ordering::Relaxed);
    }
}

/// The tasks of a node.
pub(crate) struct Members {
    /// Ascending by task.
    pub list: Box<[Member]>,
    /// For each task of the cell, its position in the list.
    places: Box<[Option<u16>]>,
}

impl Members {
    /// The given tasks, of a cell with `tasks` tasks.
    pub fn new(list: Box<[Member]>, tasks: usize) -> Self {
        let mut places = vec![None; tasks];
        for (place, member) in list.iter().enumerate() {
            places[member.task.index()] = u16::try_from(place).ok();
        }
        Self { list, places: places.into() }
    }

    /// The member that runs `task`, if this node does.
    pub fn of(&self, task: TaskId) -> Option<&Member> {
        let place = self.places.get(task.index()).copied().flatten()?;
        self.list.get(usize::from(place))
    }
}
