//! How a communication task looks to a monitor. Allocates; never called on the message path.

use super::{CommTask, Pending, Role};
use crate::ids::{PortId, TaskId};
use crate::observe::{PortView, QueueEntry, TaskState, TaskView};
use crate::table::NodeTable;
use crate::ticks::Ticks;
use alloc::vec::Vec;

impl CommTask {
    /// The task and its ports now, with at most `queue_limit` waiting messages of each port.
    #[must_use]
    pub fn view(&self, table: &NodeTable, queue_limit: usize) -> TaskView {
        let scene = self.scene(table);
        let meetings = self.meetings.iter();
        TaskView {
            task: self.task,
            state: self.state(),
            ports: self.ports(table, queue_limit),
            meetings: meetings.filter_map(|m| Some(m.view(&scene, table.port(m.port)?))).collect(),
        }
    }

    /// What the other members told in the round that this task released last or waits in.
    #[must_use]
    pub fn meeting_arguments(&self, table: &NodeTable, port: PortId, of: TaskId) -> Option<[u8; 8]> {
        let Role::Meets(meeting) = self.role(port)? else { return None };
        let rendezvous = self.meetings.get(usize::from(meeting))?;
        let member = table.port(port)?.party_index(of)?;
        let arrived = rendezvous.members.get(member)?.arrived?;
        (arrived.round == rendezvous.announced).then_some(arrived.arguments)
    }

    /// What the task is doing.
    #[must_use]
    pub fn state(&self) -> TaskState {
        match self.pending {
            Pending::Nothing => TaskState::Running,
            Pending::Get { port, deadline, .. } => TaskState::Receiving {
                port,
                remaining: (deadline != Ticks::FAR).then(|| deadline - self.now),
            },
            Pending::Reply(command) => TaskState::AwaitingReply {
                port: command.port,
                from: command.to,
                remaining: command.deadline - self.now,
            },
            Pending::Meeting(meeting) => {
                let rendezvous = &self.meetings[usize::from(meeting)];
                let remaining = rendezvous.deadline.unwrap_or(self.now) - self.now;
                TaskState::Waiting { port: rendezvous.port, round: rendezvous.announced, remaining }
            }
            Pending::Delay(..) => TaskState::Delaying,
        }
    }

    fn ports(&self, table: &NodeTable, queue_limit: usize) -> Vec<PortView> {
        let view = |local: &super::Local| {
            let port = table.port(local.port)?;
            let inbox = match local.role {
                Role::Receives(inbox) => self.inboxes.get(usize::from(inbox)),
                Role::Sends | Role::Meets(_) => None,
            };
            let waiting = inbox.map(|inbox| inbox.queue.sorted()).unwrap_or_default();
            let entry = |held: &super::Held| QueueEntry {
                source: held.source,
                id: held.id,
                class: held.class,
                remaining: held.expires - self.now,
            };
            Some(PortView {
                port: local.port,
                usage: port.party(self.task)?.usage,
                class: port.decl.class,
                len: super::index(waiting.len()),
                capacity: if inbox.is_some() { port.decl.bounded_buffer } else { 0 },
                min_slack: waiting.first().map(|(_, _, held)| held.expires - self.now),
                queue: waiting.iter().take(queue_limit).map(|(_, _, held)| entry(held)).collect(),
                counters: local.counters,
            })
        };
        self.locals.iter().filter_map(view).collect()
    }

    /// The sequence number that the task's next message will have.
    #[must_use]
    pub const fn next_sequence(&self) -> crate::ids::Seq24 {
        self.next_sequence
    }

    /// The id of the command the task waits to have answered.
    #[must_use]
    pub const fn awaits(&self) -> Option<(TaskId, crate::ids::MessageId)> {
        match &self.pending {
            Pending::Reply(command) => Some((command.to, command.id)),
            Pending::Nothing | Pending::Get { .. } | Pending::Meeting(_) | Pending::Delay(..) => None,
        }
    }
}
