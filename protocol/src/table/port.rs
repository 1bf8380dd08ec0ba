//! A checked port and its ends.

use crate::cell::{PortDecl, Rate, Usage};
use crate::ids::{PortId, TaskId};
use crate::ticks::Ticks;
use alloc::boxed::Box;

/// One end of a port: a task that owns or uses it.
#[derive(Clone, Debug)]
pub struct Party {
    /// The task.
    pub task: TaskId,
    /// What the task does with the port.
    pub usage: Usage,
    /// The default time_out of the task's own requests on the port.
    pub time_out: Ticks,
    /// How often its class-2 messages are retransmitted within that time (D5).
    pub retry: u8,
    /// The highest rate at which it sends (D53).
    pub rate: Option<Rate>,
    /// The position of the port among those of the task, by which the communication task finds its state without a search.
    pub place: u16,
}

impl Party {
    /// The time_out of a request of the task. The others at the port rely on the declared one, so a request may only shorten it.
    pub(crate) fn time_out_of(&self, wanted: Option<Ticks>) -> Ticks {
        wanted.map_or(self.time_out, |wanted| wanted.min(self.time_out))
    }
}

/// A checked port.
#[derive(Clone, Debug)]
pub struct Port {
    /// Its identifier.
    pub id: PortId,
    /// Its declaration.
    pub decl: PortDecl,
    /// Owner first, then the users in the order of the `user_list`.
    pub parties: Box<[Party]>,
    /// The hash that prefixes the checksum of the port's packets (D47).
    pub hash: u32,
    /// The safety margin of a `waitfor` (D2, D56); zero on other ports.
    pub margin: Ticks,
}

impl Port {
    /// The position of `task` among the parties.
    #[must_use]
    pub fn party_index(&self, task: TaskId) -> Option<usize> {
        self.parties.iter().position(|p| p.task == task)
    }

    /// The end of the port that `task` has.
    #[must_use]
    pub fn party(&self, task: TaskId) -> Option<&Party> {
        self.parties.iter().find(|p| p.task == task)
    }

    /// The tasks at the other end from `task`: the owner for a user, the users for the owner, all others in a `waitfor`.
    pub fn peers(&self, task: TaskId) -> impl Iterator<Item = TaskId> + '_ {
        let everyone = self.decl.usage == Usage::Waitfor;
        let own = task == self.decl.owner;
        self.parties
            .iter()
            .map(|p| p.task)
            .filter(move |&peer| peer != task && (everyone || own || peer == self.decl.owner))
    }

    /// Whether `source` may send `task` messages through this port (the insertion rule of a black channel).
    #[must_use]
    pub fn admits(&self, source: TaskId, task: TaskId) -> bool {
        self.admitted(source, task).is_some()
    }

    /// The ends of both tasks, if `source` may send to `task`.
    pub(crate) fn admitted(&self, source: TaskId, task: TaskId) -> Option<(&Party, &Party)> {
        if let [owner, user] = &*self.parties {
            let ends = if source == owner.task { (owner, user) } else { (user, owner) };
            return ((ends.0.task, ends.1.task) == (source, task)).then_some(ends);
        }
        let of_owner = source == self.decl.owner || task == self.decl.owner;
        let may = source != task && (of_owner || self.decl.usage == Usage::Waitfor);
        if may { Some((self.party(source)?, self.party(task)?)) } else { None }
    }
}
