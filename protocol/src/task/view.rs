//! How a communication task looks to a monitor. Allocates; never called on the message path.

use super::CommTask;
use crate::ids::{PortId, Round, TaskId};
use crate::observe::{PortView, QueueView, TaskState, TaskView};
use crate::table::NodeTable;
use crate::task::own::Endpoint;
use crate::task::wait::Pending;
use crate::ticks::Instant;
use alloc::vec::Vec;

impl CommTask {
    /// The task and its ports now, with at most `queue_limit` waiting messages of each port.
    #[must_use]
    pub fn view(&self, table: &NodeTable, queue_limit: usize) -> TaskView {
        self.view_of(table, |_| queue_limit)
    }

    /// [`view`](Self::view), with a number of messages for each port of its own.
    #[must_use]
    pub fn view_of(&self, table: &NodeTable, queue_limit: impl Fn(PortId) -> usize) -> TaskView {
        TaskView {
            task: self.own.task,
            state: self.state(),
            ports: self.ports(table, queue_limit),
            meetings: self.machines.meetings.view(table, &self.own).collect(),
        }
    }

    /// What another member brought to the round that this task left last; none where it was not heard there.
    #[must_use]
    pub fn meeting_arguments(&self, table: &NodeTable, port: PortId, of: TaskId) -> Option<[u8; 8]> {
        self.machines.meetings.at(self.own.meeting(port)?).told(table.port(port)?, of)
    }

    /// The round that the task announced last at this waitfor, in its present life: while it waits there, the one that it
    /// waits in. Of a task that was never there it means nothing.
    #[must_use]
    pub fn announced(&self, port: PortId) -> Option<Round> {
        Some(self.machines.meetings.at(self.own.meeting(port)?).announced())
    }

    /// What the task is doing: while a handler runs, what that does.
    #[must_use]
    pub fn state(&self) -> TaskState {
        let now = self.own.now;
        match self.machines.interrupts.pending() {
            Pending::Nothing | Pending::Work | Pending::Lease | Pending::Boundary => TaskState::Running,
            Pending::Get { port, deadline, .. } => {
                TaskState::Receiving { port, remaining: (deadline != Instant::NEVER).then(|| deadline - now) }
            }
            Pending::Reply(desk) => {
                let (port, from, deadline) = self.machines.client.wait_at(desk);
                let from = from.unwrap_or(self.own.task);
                TaskState::AwaitingReply { port, from, remaining: deadline - now }
            }
            Pending::Meeting(meeting) => self.machines.meetings.at(meeting).state(now),
            Pending::Delay(..) => TaskState::Delaying,
        }
    }

    fn ports(&self, table: &NodeTable, queue_limit: impl Fn(PortId) -> usize) -> Vec<PortView> {
        let view = |endpoint: &Endpoint| {
            let port = table.port(endpoint.port)?;
            let inbox = self.own.inbox(endpoint.port);
            let server = &self.machines.server;
            let (len, min_slack) = inbox.map_or((0, None), |inbox| server.waiting(inbox, self.own.now));
            let limit = queue_limit(endpoint.port);
            Some(PortView {
                port: endpoint.port,
                usage: port.party(self.own.task)?.usage,
                class: port.decl.class,
                len,
                capacity: if inbox.is_some() { port.decl.bounded_buffer } else { 0 },
                min_slack,
                queue: inbox.map(|inbox| server.entries(inbox, limit, self.own.now)).unwrap_or_default(),
                counters: (&endpoint.counters).into(),
            })
        };
        self.own.endpoints.iter().filter_map(view).collect()
    }

    /// What waits at a port where the task receives, with at most `limit` messages.
    #[must_use]
    pub fn queue_view(&self, port: PortId, limit: usize) -> Option<QueueView> {
        Some(self.machines.server.queue_view(&self.own, self.own.inbox(port)?, limit))
    }

    /// The sequence number that the task's next message will have.
    #[must_use]
    pub const fn next_sequence(&self) -> crate::ids::Seq24 {
        self.own.next_sequence
    }

    /// Who was asked, and the id of the command, where the task waits to have one answered: the first of several.
    #[must_use]
    pub fn awaits(&self) -> Option<(TaskId, crate::ids::MessageId)> {
        self.outstanding().next().map(|(_, task, id)| (task, id))
    }

    /// Whether the task works: it waits for nothing that its communication task or the Timer could give it.
    #[must_use]
    pub fn is_working(&self) -> bool {
        matches!(self.machines.interrupts.pending(), Pending::Nothing | Pending::Work)
    }
}
