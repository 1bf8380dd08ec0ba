//! Walks the fields of a cell state, each of which is listed once: see [`Walk`].

use super::body::{Activation, Body, Does};
use super::judge::{Name, SpecStates};
use super::plan::{CellProperty, CellScenario, Faults};
use super::script::{Actor, Running};
use super::{CellState, InFlight, NodeState};
use imrs_protocol::{Incarnation, Packet, PortId, ReplyTo, Seq24, TaskId, Ticks, Walk, mark};

/// The parts of an activation's first byte: what the activation does, and which fields follow.
const DOES: [Does; 4] = [Does::Free, Does::Waits, Does::Serves, Does::Works];
const ANSWERS: u8 = 0x04;
const NESTED: u8 = 0x08;
const GETS: u8 = 0x10;
const PORT: u8 = 0x20;
const LAST: u8 = 0x80;

/// The greatest number of activations of a task in a packed state.
const MOST_ACTIVATIONS: usize = 16;

impl CellState {
    /// Encodes, decodes or visits (as the pass `w` does) all fields but the packets in flight, whose order differs. The
    /// caller gives `behind`, because the caller knows to what `behind` is relative.
    pub(super) fn walk<W: Walk>(&mut self, behind: &mut [u8], w: &mut W) {
        let counts_behind = self.counts_behind();
        let Self {
            plan,
            // The plan or the kind of run determines these three fields.
            links: _,
            keep_log: _,
            history: _,
            nodes,
            bodies,
            in_flight: _,
            spec_states,
            faults,
            used,
            // A state with a violation is packed as the violation alone.
            violation: _,
            // Packed numbers are relative to these fields.
            rounds: _,
            sequences: _,
            behind: _,
            // These fields hold what the last transition showed, or what exists only during a transition.
            log: _,
            passed: _,
            spare: _,
            arriving: _,
            ready: _,
            turns,
            orders,
            // This field decides only what is checked, so it does not change behaviour.
            is_sampled: _,
            is_symbolic: _,
        } = self;
        faults.walk(&plan.faults, w);
        if plan.room.is_some() {
            w.raw(used);
        }
        if counts_behind {
            w.raw(behind);
        }
        for (i, node_state) in nodes.iter_mut().enumerate().filter(|(i, _)| !plan.leaves_out(*i)) {
            node_state.walk(plan, plan.clocks[i], *orders, w);
        }
        for (task, body) in bodies.iter_mut().enumerate() {
            if !plan.leaves_out_task(TaskId::from_index(task)) {
                body.walk(plan.waits().is_some(), turns.is_some(), w);
            }
        }
        spec_states.walk(plan, w);
    }
}

impl Faults {
    fn walk<W: Walk>(&mut self, had: &Self, w: &mut W) {
        let Self { loss, dup, crash, drift, late, over } = self;
        for (left, had) in [
            (loss, had.loss),
            (dup, had.dup),
            (crash, had.crash),
            (drift, had.drift),
            (late, had.late),
            (over, had.over),
        ] {
            w.byte_if(had > 0, left);
        }
    }
}

impl NodeState {
    fn walk<W: Walk>(&mut self, plan: &CellScenario, ahead: u64, orders: bool, w: &mut W) {
        if plan.incarnations() {
            self.walk_incarnations(w);
        }
        let Self {
            node,
            table,
            up,
            incarnation: _,
            known: _,
            owed,
            // This field is used only in the search of a cell, which packs it elsewhere.
            asleep: _,
        } = self;
        w.byte_if(plan.faults.late > 0, owed);
        if !*up {
            return;
        }
        let parts = node.parts_mut();
        for task in &mut parts.tasks {
            task.walk(table, w);
            if W::READS && ahead > 0 {
                task.set_ahead(table, Ticks(ahead));
            }
        }
        parts.transit.walk(table, w);
        parts.timer.walk(w);
        if orders {
            node.walk_work(w);
        }
    }
}

impl Body {
    fn walk<W: Walk>(&mut self, waits: bool, names_actions: bool, w: &mut W) {
        let Self { times, rest, activations, actor } = self;
        if let Some(Actor { host, running }) = actor {
            if W::READS {
                host.clear();
            }
            host.script.walk(&host.program, w);
            w.list(running, Running::BLANK, |running, w| running.walk(names_actions, w));
        } else {
            w.byte(times);
            w.byte(rest);
        }
        if W::READS {
            activations.clear();
        }
        if activations.len() > MOST_ACTIVATIONS {
            w.overflows();
        }
        let mut at = 0;
        loop {
            if W::READS {
                activations.push(Activation::default());
            }
            let is_last = at + 1 == activations.len();
            let Some(activation) = activations.get_mut(at) else { return };
            let is_last = activation.walk((at > 0, is_last), waits, w);
            at += 1;
            if is_last || at > MOST_ACTIVATIONS {
                return;
            }
        }
    }
}

impl Running {
    const BLANK: Self = Self { level: 0, action: 0, least: Ticks::ZERO, most: Ticks::ZERO };

    fn walk<W: Walk>(&mut self, names_actions: bool, w: &mut W) {
        let Self { level, action, least, most } = self;
        w.byte(level);
        if names_actions {
            w.small(action);
        }
        // An action without an end may end at any time from its least time on, so the time since its least time is not
        // packed.
        w.left(least, *most == Self::FOREVER);
        w.left(most, false);
    }
}

impl Activation {
    /// Encodes, decodes or visits an activation. Returns whether it is the last activation of its task.
    fn walk<W: Walk>(&mut self, (is_handler, is_last): (bool, bool), waits: bool, w: &mut W) -> bool {
        let Self { does, to, echo, nested, age, left, question, get, port, rank } = self;
        let head = w.put(
            *does as u8
                | mark(to.is_some(), ANSWERS)
                | mark(*nested, NESTED)
                | mark(*get, GETS)
                | mark(port.is_some(), PORT)
                | mark(is_last, LAST),
        );
        if W::READS {
            *does = DOES[usize::from(head) % DOES.len()];
            (*nested, *get) = (head & NESTED != 0, head & GETS != 0);
        }
        if let Some(port) = w.some(port, head & PORT != 0, PortId(0)) {
            w.small(&mut port.0);
        }
        if let Some(ReplyTo { port, source, id }) = w.some(to, head & ANSWERS != 0, ReplyTo::BLANK) {
            w.small(&mut source.0);
            w.small(&mut port.0);
            w.id(*source, Incarnation(0), id);
        }
        if matches!(does, Does::Serves | Does::Works) {
            w.byte(age);
        }
        if waits {
            if *does == Does::Waits {
                w.byte(left);
                w.byte(question);
            }
            if *does == Does::Serves || to.is_some() {
                w.byte(echo);
            }
        }
        if is_handler {
            w.byte(rank);
        }
        head & LAST != 0
    }
}

impl SpecStates {
    fn walk<W: Walk>(&mut self, plan: &CellScenario, w: &mut W) {
        let Self { remaining, handed, denied, bypassed, refused, signals, told, begun, heard, ordered } =
            self;
        w.list_if(plan.times_messages().is_some(), remaining, (Name::BLANK, 0), |(name, left), w| {
            name.walk(w);
            w.byte(left);
        });
        let ran = plan.watches(CellProperty::AtMostOnce);
        let did_not_run = plan.watches(CellProperty::DidNotRun);
        if W::READS {
            handed.fill(0);
            denied.fill(0);
        }
        if ran {
            handed.iter_mut().for_each(|mask| w.word(mask));
        }
        if did_not_run {
            handed.iter_mut().chain(denied).for_each(|mask| w.word(mask));
        }
        if plan.fair().is_some() {
            w.raw(bypassed);
        }
        w.list_if(
            plan.counts_refusals(),
            refused,
            (TaskId(0), PortId(0), Name::BLANK, 0),
            |(task, port, name, count), w| {
                w.small(&mut task.0);
                w.small(&mut port.0);
                w.byte(count);
                name.walk(w);
            },
        );
        if W::READS {
            signals.fill(0);
        }
        if plan.zeno().is_some() {
            w.raw(signals);
        }
        told.flags_mut().for_each(|flag| w.flag(flag));
        w.byte_if(plan.watches(CellProperty::OneActive), begun);
        w.byte_if(plan.watches(CellProperty::OneActive) && plan.incarnations(), heard);
        w.byte_if(plan.watches(CellProperty::FencedOrders), ordered);
    }
}

impl Name {
    const BLANK: Self = Self { source: TaskId(0), number: Seq24::new(0) };

    fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self { source, number } = self;
        w.small(&mut source.0);
        w.sequence(*source, number);
    }
}

impl InFlight {
    pub(super) const BLANK: Self =
        Self { packet: Packet::BLANK, link: 0, age: Ticks::ZERO, incarnation: Incarnation(0) };

    pub(super) fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self { packet, link, age, incarnation } = self;
        w.byte(link);
        w.age(age);
        w.incarnation(incarnation);
        packet.walk(w);
    }
}
