//! A buffer of a task as a plain list.

use imrs_protocol::{CellTable, Class, CommTask, Incarnation, PortId, ServiceOrder, TaskId};
use std::collections::BTreeSet;

/// The dedup window of class-1 messages: how many sequence numbers it reaches back.
const WINDOW: u32 = 64;

#[derive(Clone, Debug)]
pub(super) struct Buffer {
    pub port: PortId,
    pub handled: bool,
    /// How often the port was bypassed, and how often it may be bypassed.
    pub bypassed: (u16, u16),
    pub waiting: Vec<Waiting>,
    /// The messages that were accepted, of the present incarnation of each source. The next field has the messages that
    /// were handed over.
    pub taken: BTreeSet<(TaskId, u32)>,
    pub heard: BTreeSet<(TaskId, u32)>,
    /// Commands that expired in this buffer. A copy of such a command counts as new, a copy of an earlier command does not.
    pub lapsed: BTreeSet<(TaskId, u32)>,
    pub incarnations: Vec<(TaskId, Incarnation)>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    pub source: TaskId,
    pub number: u32,
    pub class: Class,
    /// When the message expires. This field and `not_before` are times on the clock of the receiver's node.
    pub expires: u64,
    pub not_before: u64,
    pub arrival: u64,
    pub rejections: u8,
    pub first_rejected: u64,
    /// Whether the message or a copy of it arrived in this step: either of them may set a later expiry.
    pub prolonged: bool,
}

impl Waiting {
    /// The order of service within a port, computed independently of the state machine's key (D14).
    pub const fn urgency(&self) -> (u64, Class, TaskId, u64) {
        (self.expires, self.class, self.source, self.arrival)
    }

    /// Counts a rejection. All messages that one step rejects count as rejected at the same time.
    pub fn reject(&mut self, order: &ServiceOrder, port: PortId, step: u64) {
        if self.rejections == 0 {
            self.first_rejected = step;
        }
        self.rejections = (self.rejections + 1).min(cap(order, port, self.source));
    }
}

impl Buffer {
    pub fn position(&self, source: TaskId, number: u32) -> Option<usize> {
        self.waiting.iter().position(|one| (one.source, one.number) == (source, number))
    }

    /// Called when a message of this incarnation of a source has arrived. Entries of an earlier incarnation then no
    /// longer count.
    pub fn enter(&mut self, source: TaskId, incarnation: Incarnation) {
        match self.incarnations.iter_mut().find(|(task, _)| *task == source) {
            None => self.incarnations.push((source, incarnation)),
            Some((_, known)) if *known == incarnation => {}
            Some((_, known)) => {
                *known = incarnation;
                self.taken.retain(|(task, _)| *task != source);
                self.heard.retain(|(task, _)| *task != source);
                self.lapsed.retain(|(task, _)| *task != source);
            }
        }
    }

    /// Whether the state machine may drop this message as a duplicate.
    pub fn knows(&self, source: TaskId, number: u32, class: Class) -> bool {
        self.taken.contains(&(source, number))
            || self.taken.union(&self.lapsed).filter(|(task, _)| *task == source).any(|&(_, newer)| {
                match class {
                    Class::Command => newer > number,
                    Class::Status => newer > number + WINDOW,
                }
            })
    }
}

/// How many rejections make a message outrank the task's own thread (D58).
pub(super) fn cap(order: &ServiceOrder, port: PortId, source: TaskId) -> u8 {
    order.rank(port, source).max(1)
}

pub(super) fn buffers(table: &CellTable, task: &CommTask) -> Vec<Buffer> {
    let of_port = |&port: &PortId| {
        task.queue_view(port, 0).map(|view| Buffer {
            port,
            handled: view.handled,
            bypassed: (0, view.bypass_limit),
            waiting: Vec::new(),
            taken: BTreeSet::new(),
            heard: BTreeSet::new(),
            lapsed: BTreeSet::new(),
            incarnations: Vec::new(),
        })
    };
    table.ports_of(task.task()).iter().filter_map(of_port).collect()
}
