//! What a script learns of its communication task, besides the signals.

use imrs_protocol::{CommTask, Contents, NodeTable, PortId, ReplyTo, TaskId};

/// A communication task, for its script to ask.
#[derive(Clone, Copy)]
pub(crate) struct Knows<'a> {
    pub machine: &'a CommTask,
    pub table: &'a NodeTable,
}

impl Knows<'_> {
    /// A fragment of the message that came last (D28).
    pub fn fragment(self, index: u8) -> Option<Contents> {
        self.machine.fragment(index).copied()
    }

    /// What the partner of the task's couple published last.
    pub fn published(self) -> Option<Contents> {
        self.machine.partner_published().copied()
    }

    /// What a member told at a waitfor.
    pub fn arrival(self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        self.machine.meeting_arguments(self.table, port, task)
    }

    /// The message of a task that this one took and still owes an answer.
    pub fn owed(self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.machine.owed(port, task)
    }

    /// A fragment of an answer: that of `task`, or of the only one asked.
    pub fn answer(self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        if let Some(task) = task {
            return self.machine.answer_fragment(port, task, index).copied();
        }
        let mut peers = self.table.port(port)?.peers(self.machine.task());
        peers.find_map(|peer| self.machine.answer_fragment(port, peer, index).copied())
    }
}
