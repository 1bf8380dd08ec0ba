//! Fused steps within a node: which two tasks a request concerns. `task/fused.rs` says what they do.

mod gathering;

pub use gathering::{Gathering, Members};

use super::work::Work;
use super::{Node, NodeOutbox, Parts, TaskEffects};
use crate::ids::{PortId, TaskId};
use crate::mapping;
use crate::request::{Request, Target};
use crate::table::{Ends, NodeTable};
use crate::task::{CommTask, Outbox};
use alloc::collections::VecDeque;

/// What a request concerns that one fused step may carry out: one other task of the same node (D176).
#[derive(Clone, Copy, Debug)]
pub struct Fusible<'a> {
    ends: Ends<'a>,
    /// The position of the other task among the node's tasks, ascending by task.
    pub other: usize,
}

impl<'a> Fusible<'a> {
    /// What `request` of `task` concerns. `None` if the request concerns no other task of the node, or several.
    #[must_use]
    #[inline(always)]
    pub fn of(table: &'a NodeTable, task: TaskId, request: &Request) -> Option<Self> {
        match *request {
            Request::Send { port, to, .. } => Self::to(table, task, port, to),
            Request::Reply { to, .. } => Self::to(table, task, to.port, Target::One(to.source)),
            _ => None,
        }
    }

    #[inline(always)]
    fn to(table: &'a NodeTable, task: TaskId, port: PortId, to: Target) -> Option<Self> {
        let (port, own) = mapping::own_end(table, port, task).ok()?;
        let peer = mapping::only_peer(own, to).filter(|_| table.is_decided())?;
        Some(Self { ends: Ends { port, own, peer }, other: table.place(peer.task)? })
    }

    /// The task `own` takes the request in one step together with the task `other`. The clocks of both must show the same
    /// time, and `other` must have taken all that `own` sent before. Returns false, and changes nothing, if the request
    /// needs small steps.
    #[inline(always)]
    pub fn step(
        self,
        own: &mut CommTask,
        other: &mut CommTask,
        request: &Request,
        out: &mut impl NodeOutbox,
    ) -> bool {
        match *request {
            Request::Send { contents, time_out, .. } => {
                own.send_fused(other, self.ends, (contents, time_out), out)
            }
            Request::Reply { to, contents } => own.reply_fused(other, self.ends, (to, contents), out),
            _ => false,
        }
    }
}

impl Node {
    /// Takes a request as one fused step with the other tasks that it concerns (D176, D193); [`step`](Self::step) does so
    /// by itself. Returns false, and changes nothing, if the request needs small steps.
    pub fn fuse(&mut self, task: TaskId, request: &Request, out: &mut impl NodeOutbox) -> bool {
        let Parts { table, tasks, .. } = &mut self.parts;
        let Some(fusible) = Fusible::of(table, task, request) else {
            return matches!(request, Request::Arrive { .. }) && self.gather(task, request, out);
        };
        let Some(place) = table.place(task) else { return false };
        let Ok([own, other]) = tasks.get_disjoint_mut([place, fusible.other]) else { return false };
        fusible.step(own, other, request, out)
    }

    /// A function of its own, so that messages and answers do not become slower by it.
    #[inline(never)]
    fn gather(&mut self, task: TaskId, request: &Request, out: &mut impl NodeOutbox) -> bool {
        let Parts { table, tasks, .. } = &mut self.parts;
        let Some(gathering) = Gathering::of(table, task, request) else { return false };
        gathering.step(&mut Local { tasks, work: &mut self.work, out })
    }
}

/// The tasks of a node, and where their effects go.
struct Local<'a, O> {
    tasks: &'a mut [CommTask],
    work: &'a mut VecDeque<Work>,
    out: &'a mut O,
}

impl<O: NodeOutbox> Members for Local<'_, O> {
    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox) {
        let Self { tasks, work, out } = self;
        let task = &mut tasks[place];
        let effects = TaskEffects { task: task.task(), work, out: *out };
        (task, effects)
    }
}
