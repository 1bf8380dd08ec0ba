//! A communication task as a monitor sees it. These functions allocate, and are never called on the message path.

use super::CommTask;
use crate::ids::{PortId, Round, TaskId};
use crate::observe::{PortView, QueueView, TaskState, TaskView};
use crate::table::NodeTable;
use crate::task::own::Endpoint;
use crate::task::wait::Pending;
use crate::ticks::Instant;
use alloc::vec::Vec;

impl CommTask {
    /// The task and its ports as they are now, with up to `queue_limit` waiting messages per port.
    #[must_use]
    pub fn view(&self, table: &NodeTable, queue_limit: usize) -> TaskView {
        self.view_of(table, |_| queue_limit)
    }

    /// Like [`view`](Self::view), with a separate limit for each port.
    #[must_use]
    pub fn view_of(&self, table: &NodeTable, queue_limit: impl Fn(PortId) -> usize) -> TaskView {
        TaskView {
            task: self.own.task,
            state: self.state(),
            ports: self.ports(table, queue_limit),
            meetings: self.machines.meetings.view(table, &self.own).collect(),
        }
    }

    /// Another member's arguments in the round that this task left last; `None` if that member had not arrived.
    #[must_use]
    pub fn meeting_arguments(&self, table: &NodeTable, port: PortId, of: TaskId) -> Option<[u8; 8]> {
        self.machines.meetings.at(self.own.meeting(port)?).told(table.port(port)?, of)
    }

    /// The round that the task announced last at this waitfor in its present incarnation. While the task waits there, it
    /// waits in this round. For a task that never reached this waitfor, the value means nothing.
    #[must_use]
    pub fn announced(&self, port: PortId) -> Option<Round> {
        Some(self.machines.meetings.at(self.own.meeting(port)?).announced())
    }

    /// The state of the running activation: of a handler, if one runs.
    #[must_use]
    pub fn state(&self) -> TaskState {
        let now = self.own.now;
        match self.machines.interrupts.pending() {
            Pending::Nothing | Pending::Work | Pending::Lease | Pending::Boundary => TaskState::Running,
            Pending::Get { port, deadline, .. } => {
                TaskState::Receiving { port, remaining: (deadline != Instant::NEVER).then(|| deadline - now) }
            }
            Pending::Reply(request) => {
                let (port, from, deadline) = self.machines.client.wait_at(request);
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

    /// The waiting messages of a port on which the task receives, up to `limit` of them.
    #[must_use]
    pub fn queue_view(&self, port: PortId, limit: usize) -> Option<QueueView> {
        Some(self.machines.server.queue_view(&self.own, self.own.inbox(port)?, limit))
    }

    /// The sequence number of the task's next message.
    #[must_use]
    pub const fn next_sequence(&self) -> crate::ids::Seq24 {
        self.own.next_sequence
    }

    /// The first task whose answer to a command is missing, and the id of that command; `None` if no answer is missing.
    #[must_use]
    pub fn awaits(&self) -> Option<(TaskId, crate::ids::MessageId)> {
        self.outstanding().next().map(|(_, task, id)| (task, id))
    }

    /// Whether the task works: it waits neither for its communication task nor for the Timer.
    #[must_use]
    pub fn is_working(&self) -> bool {
        matches!(self.machines.interrupts.pending(), Pending::Nothing | Pending::Work)
    }
}
