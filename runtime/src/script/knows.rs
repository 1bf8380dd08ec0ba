//! What a script can read of its communication task, besides the signals.

use imrs_protocol::script::{Action, Address, End, ScriptOutbox};
use imrs_protocol::{CommTask, Contents, NodeTable, PortId, ReplyTo, Request, TaskId};

/// A communication task, as its script may read it.
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

    /// The arguments of a member's arrival at a waitfor.
    pub fn arrival(self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        self.machine.meeting_arguments(self.table, port, task)
    }

    /// The message of a task that this one has taken and not answered yet.
    pub fn owed(self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.machine.owed(port, task)
    }

    /// A fragment of the answer of `task`, or of the only task asked.
    pub fn answer(self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        if let Some(task) = task {
            return self.machine.answer_fragment(port, task, index).copied();
        }
        let mut peers = self.table.port(port)?.peers(self.machine.task());
        peers.find_map(|peer| self.machine.answer_fragment(port, peer, index).copied())
    }
}

/// Takes the output of a script, as [`ScriptOutbox`] does. [`Outlet`] answers what the script reads of its communication task.
pub(crate) trait Does {
    fn request(&mut self, request: Request);
    fn run(&mut self, action: Action<'_>);
    fn cut_short(&mut self, level: u8);
    fn choose(&mut self, alternatives: u16) -> Option<u16>;
    fn ended(&mut self, end: End);
    fn statement(&mut self, at: Address);
    fn unanswered(&mut self, message: ReplyTo);
}

/// The outbox of a script's step.
pub(crate) struct Outlet<'a, D> {
    pub knows: Knows<'a>,
    pub does: D,
}

impl<D: Does> ScriptOutbox for Outlet<'_, D> {
    fn request(&mut self, request: Request) {
        self.does.request(request);
    }

    fn run(&mut self, action: Action<'_>) {
        self.does.run(action);
    }

    fn cut_short(&mut self, level: u8) {
        self.does.cut_short(level);
    }

    fn choose(&mut self, alternatives: u16) -> Option<u16> {
        self.does.choose(alternatives)
    }

    fn ended(&mut self, end: End) {
        self.does.ended(end);
    }

    fn statement(&mut self, at: Address) {
        self.does.statement(at);
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.does.unanswered(message);
    }

    fn fragment(&mut self, index: u8) -> Option<Contents> {
        self.knows.fragment(index)
    }

    fn published(&mut self) -> Option<Contents> {
        self.knows.published()
    }

    fn arrival(&mut self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        self.knows.arrival(port, task)
    }

    fn owed(&mut self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.knows.owed(port, task)
    }

    fn answer(&mut self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        self.knows.answer(port, task, index)
    }
}
