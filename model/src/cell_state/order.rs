//! Properties of the order of service: what may interrupt what (D15, D16), bounds on rejections and bypasses (D58).

use super::CellState;
use super::body::Does;
use super::judge::Name;
use super::plan::CellProperty;
use crate::state::Violation;
use imrs_protocol::rules::Aging;
use imrs_protocol::{Call, Delivery, PortId, ServiceOrder, TaskId};

/// The greatest number of activations of a task: its thread, and two handlers more than `order` has ranks (D15).
const DEEPEST: usize = ServiceOrder::LEVELS + 3;

impl CellState {
    /// Records that a message was rejected. A message that was rejected as often as ranks stand above it outranks the
    /// thread, but never a handler. So the bound on rejections holds only for tasks whose handlers do not wait (D76).
    pub(super) fn refused(&mut self, task: TaskId, port: PortId, name: Name) -> Result<(), Violation> {
        if !self.plan.counts_refusals() {
            return Ok(());
        }
        let cap = self.plan.tasks[task.index()].order.rank(port, name.source).max(1);
        let most = self.plan.fair().filter(|fair| fair.0 == task).map(|fair| fair.2);
        let entries = &mut self.spec_states.refused;
        let at = entries.iter().position(|e| (e.0, e.1, e.2) == (task, port, name)).unwrap_or(entries.len());
        if at == entries.len() {
            entries.push((task, port, name, 0));
        }
        let count = &mut entries[at].3;
        // If the plan has no bound for rejections, rejections beyond the cap need not be counted.
        *count = if most.is_some() { count.saturating_add(1) } else { count.saturating_add(1).min(cap) };
        if most.is_some_and(|most| *count > most) { Err(Violation::RefusedTooOften) } else { Ok(()) }
    }

    /// Forgets the rejections of a message that is no longer queued.
    pub(super) fn forget(&mut self, task: usize, delivery: &Delivery) {
        let gone = (TaskId::from_index(task), delivery.from.port, Name::of(delivery));
        self.spec_states.refused.retain(|e| (e.0, e.1, e.2) != gone);
    }

    /// How often the message of a call was rejected, as far as aging counts rejections.
    fn refusals(&self, task: usize, call: &Call) -> u8 {
        let Call::Message(delivery) = call else { return 0 };
        if self.plan.cell.cell().rules.aging != Aging::Bounded {
            return 0;
        }
        let (at, name) = (TaskId::from_index(task), Name::of(delivery));
        let entries = self.spec_states.refused.iter();
        entries.filter(|e| (e.0, e.1, e.2) == (at, delivery.from.port, name)).map(|e| e.3).sum()
    }

    fn base_rank(&self, task: usize, call: &Call) -> u8 {
        let order = &self.plan.tasks[task].order;
        match call {
            Call::Message(delivery) => order.rank(delivery.from.port, delivery.from.source),
            Call::Timer(id) => order.timer(*id),
            Call::Fenced | Call::TakeOver(_) => 0,
        }
    }

    /// Judges an interruption by the declared `order` and the rejections that were counted (R16, D15, D58).
    pub(super) fn judge_interrupt(&self, task: usize, call: &Call) -> Result<(), Violation> {
        let body = &self.bodies[task];
        let top = body.top();
        if body.activations.len() >= DEEPEST {
            return Err(Violation::TooDeep);
        }
        if !matches!(top.does, Does::Waits | Does::Works) {
            return Err(Violation::NotOutranking);
        }
        if !self.plan.watches(CellProperty::Order) || matches!(call, Call::Fenced | Call::TakeOver(_)) {
            return Ok(());
        }
        let (base, refused) = (self.base_rank(task, call), self.refusals(task, call));
        let rank = base.saturating_sub(refused);
        let outranks = if body.activations.len() > 1 {
            rank < top.rank
        } else {
            let plain_get = top.get;
            let capped = refused >= base.max(1);
            plain_get || capped || rank < self.plan.tasks[task].order.own()
        };
        if outranks { Ok(()) } else { Err(Violation::NotOutranking) }
    }

    /// The rank at which a handler runs: the rank of its message, but never a later rank than that of the activation that
    /// it interrupts.
    pub(super) fn rank_of_handler(&self, task: usize, call: &Call) -> u8 {
        let body = &self.bodies[task];
        let below =
            if body.activations.len() > 1 { body.top().rank } else { self.plan.tasks[task].order.own() };
        self.base_rank(task, call).min(below)
    }

    /// Counts bypasses: a GET over all ports that takes the first message of one port bypasses the other ports that have
    /// messages (D58).
    pub(super) fn judge_bypass(&mut self, task: usize, delivery: &Delivery) -> Result<(), Violation> {
        let Some((watched, most, _)) = self.plan.fair() else { return Ok(()) };
        let at = TaskId::from_index(task);
        let top = self.bodies[task].top();
        if watched != at || !top.get || top.port.is_some() {
            return Ok(());
        }
        let node_state = &self.nodes[self.node_state_of(task)];
        let Some(machine) = node_state.node.task(at) else { return Ok(()) };
        let view = machine.view(&node_state.table, 0);
        for (count, port) in self.spec_states.bypassed.iter_mut().zip(&view.ports) {
            let handled = self.plan.tasks[task].handles.contains(&port.port);
            if port.port == delivery.from.port || port.len == 0 || handled {
                *count = 0;
            } else {
                *count += 1;
                if *count > most {
                    return Err(Violation::Bypassed);
                }
            }
        }
        Ok(())
    }
}
