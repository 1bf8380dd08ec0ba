//! How a communication task looks to a monitor. Allocates; never called on the message path.

use super::{CommTask, Pending, Role};
use crate::ids::{PortId, Round, TaskId};
use crate::observe::{HeldView, PortView, QueueEntry, QueueView, TaskState, TaskView};
use crate::table::NodeTable;
use crate::ticks::Ticks;
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
        let scene = self.scene(table);
        let meetings = self.meetings.iter();
        TaskView {
            task: self.task,
            state: self.state(),
            ports: self.ports(table, queue_limit),
            meetings: meetings.filter_map(|m| Some(m.view(&scene, table.port(m.port)?))).collect(),
        }
    }

    /// What another member brought to the round that this task left last; none where it was not heard there.
    #[must_use]
    pub fn meeting_arguments(&self, table: &NodeTable, port: PortId, of: TaskId) -> Option<[u8; 8]> {
        let Role::Meets(meeting) = self.role(port)? else { return None };
        let rendezvous = self.meetings.get(usize::from(meeting))?;
        let member = table.port(port)?.party_index(of)?;
        rendezvous.members.get(member)?.told
    }

    /// The round that the task announced last at this waitfor, in its present life: while it waits there, the one that it
    /// waits in. Of a task that was never there it means nothing.
    #[must_use]
    pub fn announced(&self, port: PortId) -> Option<Round> {
        let Role::Meets(meeting) = self.role(port)? else { return None };
        self.meetings.get(usize::from(meeting)).map(|rendezvous| rendezvous.announced)
    }

    /// What the task is doing: while a handler runs, what that does.
    #[must_use]
    pub fn state(&self) -> TaskState {
        match self.top().pending {
            Pending::Nothing | Pending::Work | Pending::Lease | Pending::Boundary => TaskState::Running,
            Pending::Get { port, deadline, .. } => TaskState::Receiving {
                port,
                remaining: (deadline != Ticks::FAR).then(|| deadline - self.now),
            },
            Pending::Reply(desk) => {
                let desk = &self.desks[usize::from(desk)];
                let from = desk.open().next().map_or(self.task, |asked| asked.task);
                TaskState::AwaitingReply { port: desk.port, from, remaining: desk.deadline - self.now }
            }
            Pending::Meeting(meeting) => {
                let rendezvous = &self.meetings[usize::from(meeting)];
                let remaining = rendezvous.deadline.unwrap_or(self.now) - self.now;
                TaskState::Waiting { port: rendezvous.port, round: rendezvous.announced, remaining }
            }
            Pending::Delay(..) => TaskState::Delaying,
        }
    }

    fn ports(&self, table: &NodeTable, queue_limit: impl Fn(PortId) -> usize) -> Vec<PortView> {
        let view = |local: &super::Local| {
            let port = table.port(local.port)?;
            let inbox = match local.role {
                Role::Receives(inbox) => self.inboxes.get(usize::from(inbox)),
                Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Beats => {
                    None
                }
            };
            let waiting = inbox.map(|inbox| inbox.queue.sorted()).unwrap_or_default();
            Some(PortView {
                port: local.port,
                usage: port.party(self.task)?.usage,
                class: port.decl.class,
                len: super::index(waiting.len()),
                capacity: if inbox.is_some() { port.decl.bounded_buffer } else { 0 },
                min_slack: waiting.first().map(|(_, held)| held.expires - self.now),
                queue: waiting
                    .iter()
                    .take(queue_limit(local.port))
                    .map(|(_, held)| self.entry(held))
                    .collect(),
                counters: (&local.counters).into(),
            })
        };
        self.locals.iter().filter_map(view).collect()
    }

    fn entry(&self, held: &super::inbox::Held) -> QueueEntry {
        let remaining = held.expires - self.now;
        QueueEntry { source: held.source, id: held.id(), class: held.class, remaining }
    }

    /// What waits at a port where the task receives, with at most `limit` messages.
    #[must_use]
    pub fn queue_view(&self, port: PortId, limit: usize) -> Option<QueueView> {
        let Role::Receives(inbox) = self.role(port)? else { return None };
        let inbox = self.inboxes.get(usize::from(inbox))?;
        let held = |(slot, held): &(crate::queue::Slot, &super::inbox::Held)| {
            let (aged, base) = (inbox.queue.side(*slot), self.order.rank(port, held.source));
            HeldView {
                entry: self.entry(held),
                arrival: held.arrival,
                fragments: held.fragments,
                rank: inbox.handled.then(|| base.saturating_sub(aged.rejections)),
                rejections: aged.rejections,
                capped: inbox.handled && aged.rejections >= Self::cap(base),
                back_off: aged.not_before - self.now,
            }
        };
        Some(QueueView {
            handled: inbox.handled,
            bypassed: inbox.bypassed(self.served),
            bypass_limit: self.bypass_limit(),
            queue: inbox.queue.sorted().iter().take(limit).map(held).collect(),
        })
    }

    /// The sequence number that the task's next message will have.
    #[must_use]
    pub const fn next_sequence(&self) -> crate::ids::Seq24 {
        self.next_sequence
    }

    /// Who was asked, and the id of the command, where the task waits to have one answered: the first of several.
    #[must_use]
    pub fn awaits(&self) -> Option<(TaskId, crate::ids::MessageId)> {
        self.outstanding().next().map(|(_, task, id)| (task, id))
    }

    /// Whether the task works: it waits for nothing that its communication task or the Timer could give it.
    #[must_use]
    pub fn is_working(&self) -> bool {
        matches!(self.top().pending, Pending::Nothing | Pending::Work)
    }
}
