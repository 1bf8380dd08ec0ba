//! A GET as a fused step, which bypasses [`handle`](CommTask::handle): alone, or right after an answer (D200).

use super::CommTask;
use crate::ids::{PortId, TaskId};
use crate::node::NodeOutbox;
use crate::observe::Observation;
use crate::packet::Packet;
use crate::request::{Request, Signal, TimeId};
use crate::table::NodeTable;
use crate::task::step::{Outbox, Step};
use crate::ticks::Ticks;

/// A GET: its port, the source whose messages suit, and how long it waits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Get {
    port: Option<PortId>,
    source: Option<TaskId>,
    time_out: Option<Ticks>,
}

impl Get {
    /// The GET that a request makes; `None` for any other request.
    #[inline]
    pub fn of(request: &Request) -> Option<Self> {
        if let Request::Get { port, source, time_out } = *request {
            Some(Self { port, source, time_out })
        } else {
            None
        }
    }
}

impl CommTask {
    /// Takes a GET as one fused step of this task alone (D200). Returns false, and changes nothing, if a handler could interrupt
    /// the task, or the request is no GET.
    #[inline(always)]
    pub fn fuse_get(&mut self, table: &NodeTable, request: &Request, out: &mut impl NodeOutbox) -> bool {
        let Some(get) = Get::of(request).filter(|_| self.may_get()) else { return false };
        self.get(table, get, out);
        true
    }

    /// Whether [`get`](Self::get) has all effects of a GET: the running activation waits for nothing, and no handler could
    /// interrupt its wait.
    #[inline(always)]
    pub(crate) fn may_get(&self) -> bool {
        self.machines.interrupts.waits_for_nothing() && self.machines.is_plain()
    }

    /// Carries out a GET that [`may_get`](Self::may_get) allows: delivers the most urgent message, or lets the task wait for one.
    #[inline(always)]
    pub(crate) fn get(
        &mut self,
        table: &NodeTable,
        Get { port, source, time_out }: Get,
        out: &mut impl NodeOutbox,
    ) {
        let Self { own, machines, due } = self;
        *due = None;
        let task = own.task;
        let mut step = Step { table, own, out: &mut OfTask { task, out } };
        match machines.get(&mut step, (port, source), time_out) {
            Ok(Some(signal)) => step.out.signal(signal),
            Ok(None) => {}
            Err(fault) => step.out.signal(Signal::Fault(fault)),
        }
    }
}

/// The outbox of one task's part in a fused step, which uses no Timer. It delivers no packet.
pub(crate) struct OfTask<'a, O> {
    pub task: TaskId,
    pub out: &'a mut O,
}

impl<O: NodeOutbox> Outbox for OfTask<'_, O> {
    const TRANSMITS: bool = false;

    fn transmit(&mut self, _: Packet) {}

    #[inline(always)]
    fn signal(&mut self, signal: Signal) {
        self.out.signal(self.task, signal);
    }

    fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}

    fn disarm(&mut self, _: TimeId) {}

    #[inline(always)]
    fn observe(&mut self, observation: Observation) {
        self.out.observe(Some(self.task), observation);
    }
}
