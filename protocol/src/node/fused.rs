//! Fused steps within a node: finds the two tasks that a request concerns. `task/fused.rs` carries out the step.

mod gathering;

pub use gathering::{Gathering, Members};

use super::{Node, NodeOutbox, Parts};
use crate::ids::{PortId, TaskId};
use crate::mapping;
use crate::observe::Observation;
use crate::request::{Request, Target};
use crate::table::{Ends, NodeTable};
use crate::task::{CommTask, Get, OfTask, Outbox};

/// A request that one fused step may carry out, with the one other task of the same node that it concerns (D176).
#[derive(Clone, Copy, Debug)]
pub struct Fusible<'a> {
    ends: Ends<'a>,
    /// The position of the other task among the node's tasks, ascending by task.
    pub other: usize,
}

impl<'a> Fusible<'a> {
    /// Finds the other task that `request` of `task` concerns. `None` if the request concerns no other task of the node, or
    /// several.
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

    /// Carries out a REPLY of the task `own` to `other` and the next GET of `own` in one step: `own` then takes its next message,
    /// or waits for it (D200). Conditions and result are those of [`step`](Self::step).
    #[inline(always)]
    pub fn reply_and_get(
        self,
        table: &NodeTable,
        (own, other): (&mut CommTask, &mut CommTask),
        [reply, get]: [&Request; 2],
        out: &mut impl NodeOutbox,
    ) -> bool {
        let (&Request::Reply { to, contents }, Some(get)) = (reply, Get::of(get)) else { return false };
        let is_done = own.may_get() && own.reply_fused(other, self.ends, (to, contents), out);
        if is_done {
            own.get(table, get, out);
        }
        is_done
    }

    /// Carries out the request of the task `own` in one step together with `other`. The clocks of both tasks must show the same
    /// time, and `other` must have taken everything that `own` sent before. Returns false, and changes nothing, if the request
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
            return match request {
                Request::Get { .. } => {
                    table.place(task).is_some_and(|place| tasks[place].fuse_get(table, request, out))
                }
                Request::Arrive { .. } => self.gather(task, request, out),
                _ => false,
            };
        };
        let Some(place) = table.place(task) else { return false };
        let Ok([own, other]) = tasks.get_disjoint_mut([place, fusible.other]) else { return false };
        fusible.step(own, other, request, out)
    }

    /// Takes a REPLY and the GET that its task makes next as one fused step, with the effects of two [`step`](Self::step)s at the
    /// node's time (D200). Returns false, and changes nothing, if the two need small steps.
    pub fn reply_and_get(
        &mut self,
        task: TaskId,
        requests: [&Request; 2],
        out: &mut impl NodeOutbox,
    ) -> bool {
        let Parts { table, tasks, .. } = &mut self.parts;
        let Some(fusible) = Fusible::of(table, task, requests[0]) else { return false };
        let Some(place) = table.place(task) else { return false };
        let Ok([own, other]) = tasks.get_disjoint_mut([place, fusible.other]) else { return false };
        fusible.reply_and_get(table, (own, other), requests, out)
    }

    /// A separate function that is not inlined, so that the code for messages and answers stays short.
    #[inline(never)]
    fn gather(&mut self, task: TaskId, request: &Request, out: &mut impl NodeOutbox) -> bool {
        let Parts { table, tasks, .. } = &mut self.parts;
        let Some(gathering) = Gathering::of(table, task, request) else { return false };
        gathering.step(&mut Local { tasks, out }).is_some()
    }
}

/// The tasks of a node, and where their effects go.
struct Local<'a, O> {
    tasks: &'a mut [CommTask],
    out: &'a mut O,
}

impl<O: NodeOutbox> Members for Local<'_, O> {
    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox) {
        let task = &mut self.tasks[place];
        let effects = OfTask { task: task.task(), out: self.out };
        (task, effects)
    }

    fn hearing(&mut self, place: usize) -> (&mut CommTask, impl FnOnce(Observation)) {
        let Self { tasks, out } = self;
        let task = tasks[place].task();
        (&mut tasks[place], move |observation| out.observe(Some(task), observation))
    }
}
