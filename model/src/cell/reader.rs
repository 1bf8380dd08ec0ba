//! Finds, for each step of a path, the line of the cell's text to which the step belongs, and the values that its messages
//! carry.

use super::judge::{position, program};
use super::run_state::RunState;
use crate::cell_state::Effect;
use crate::cell_state::script::ScriptReaction;
use imrs_protocol::script::{Address, End, Op, Program, Trigger};
use imrs_protocol::{
    Call, Contents, Event, Kind, Observation, Outcome, Packet, PortId, ReplyTo, Signal, Target, TaskId,
};
use std::collections::BTreeMap;

/// Names a message or a round: the task that sent the message or reached the round, the port, and the number.
type Named = (usize, PortId, u32);

/// Finds the line and the values of everything that a step shows.
#[derive(Default)]
pub(super) struct Reader {
    /// The statement that sent or answered each message, or reached each round.
    sent: BTreeMap<Named, Address>,
    step: StepAt,
}

/// What the reader knows of one step of the path.
#[derive(Default)]
struct StepAt {
    /// The operation of each task before the step.
    before: Vec<Address>,
    /// The statements that each task may have executed in the step, each with the number of observations matched to it.
    begun: Vec<Vec<(Address, usize)>>,
    /// The statement whose outcome each task learns next.
    outcome: Vec<Option<Address>>,
    /// The contents of the messages that tasks took.
    taken: BTreeMap<Named, Contents>,
    /// The packet whose values the chart shows in this step.
    drawn: Option<Packet>,
}

impl Reader {
    /// Begins a step. `begun` is the statement that each task began last.
    pub fn before(&mut self, run_state: &RunState, begun: &[Option<Address>], drawn: Option<Packet>) {
        let tasks = run_state.plan.tasks.len();
        self.step = StepAt {
            before: (0..tasks).map(|task| position(run_state, task)).collect(),
            begun: begun.iter().map(|at| at.iter().map(|&at| (at, 0)).collect()).collect(),
            outcome: vec![None; tasks],
            taken: BTreeMap::new(),
            drawn,
        };
    }

    /// Ends a step: reads what the scripts did in the step, and the step's log.
    pub fn after(&mut self, turns: &[ScriptReaction], log: &[Effect]) {
        for turn in turns {
            if let Some(begun) = self.step.begun.get_mut(turn.task) {
                begun.extend(turn.passed.iter().map(|&at| (at, 0)));
            }
        }
        for effect in log {
            if let Effect::Signalled(
                _,
                Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery)),
            ) = effect
            {
                let ReplyTo { port, source, id } = delivery.from;
                self.step.taken.insert((source.index(), port, id.sequence.get()), delivery.contents);
            }
        }
    }

    /// The line of the statement that sent a packet.
    pub fn of_packet(&mut self, run_state: &RunState, packet: &Packet) -> Option<u32> {
        let (event, number) = match packet.kind {
            Kind::Send | Kind::Query => (Event::Sent, packet.id.sequence.get()),
            Kind::Reply | Kind::Response => (Event::Replied, packet.id.sequence.get()),
            Kind::Arrive => (Event::Reached, u32::from(packet.meeting().round.0)),
            Kind::Confirm | Kind::Abort | Kind::Control => return None,
        };
        let task = packet.source.index();
        let named = (task, packet.port, number);
        // A packet that left before the first step is in no step. Its task is still at the statement that sent the packet.
        let at = self.sent.get(&named).copied().or_else(|| {
            let begun = self.step.begun.get(task)?.first()?.0;
            let program = program(run_state, task)?;
            operations(program, begun).any(|op| does(op, event, packet.port)).then_some(begun)
        })?;
        self.sent.insert(named, at);
        run_state.plan.legend.line(task, at)
    }

    /// The line of the action that this activation runs.
    pub fn of_action(&self, run_state: &RunState, task: usize, level: u8) -> Option<u32> {
        let script = &run_state.cell.bodies.get(task)?.actor.as_ref()?.host.script;
        let at = match level {
            _ if level == script.depth() => script.position(),
            0 => script.position_at(0)?,
            _ => return None,
        };
        run_state.plan.legend.line(task, at)
    }

    /// The line at which a script has ended.
    pub fn of_end(&self, run_state: &RunState, turn: &ScriptReaction) -> Option<u32> {
        let at = match turn.end? {
            End::Assertion(at) | End::Fault { at, .. } => at,
            End::Finished | End::Aborted(_) | End::Fenced => *turn.passed.last().unwrap_or(&turn.at),
        };
        run_state.plan.legend.line(turn.task, at)
    }

    /// The line to which an effect belongs, and the values that the task takes or gets with it.
    pub fn of_effect(&mut self, run_state: &RunState, effect: &Effect) -> (Option<u32>, Option<String>) {
        match effect {
            Effect::Seen(_, Some(task), seen) => self.of_observation(run_state, task.index(), seen),
            Effect::Signalled(task, signal) => self.of_signal(run_state, task.index(), signal),
            Effect::Seen(_, None, _) | Effect::Sent(..) => (None, None),
        }
    }

    fn of_observation(
        &mut self,
        run_state: &RunState,
        task: usize,
        seen: &Observation,
    ) -> (Option<u32>, Option<String>) {
        let legend = &run_state.plan.legend;
        let named = (task, seen.port, seen.number);
        let before = self.step.before.get(task).copied();
        let at = match seen.event {
            Event::Sent | Event::Reached | Event::Replied => {
                let at = self.carried_out(run_state, task, seen);
                if let Some(at) = at {
                    self.sent.insert(named, at);
                }
                at
            }
            Event::Resent
            | Event::TimedOut
            | Event::TimedOutUnsent
            | Event::ReleasedComplete
            | Event::ReleasedByConfirm
            | Event::WithinMargin
            | Event::GaveUp => self.sent.get(&named).copied().or(before),
            Event::Rejoined => {
                // The task goes on with the same wait in another round.
                if let Some(at) = before {
                    self.sent.insert(named, at);
                }
                before
            }
            Event::Answered | Event::RefusedByPeer | Event::PeerRestarted => {
                if let Some(outcome) = self.step.outcome.get_mut(task) {
                    *outcome = self.sent.get(&named).copied();
                }
                None
            }
            Event::Delivered => {
                let message = (seen.peer.index(), seen.port, seen.number);
                let is_drawn = |packet: Packet| {
                    (packet.source.index(), packet.port, packet.id.sequence.get()) == message
                };
                let values = self
                    .step
                    .taken
                    .get(&message)
                    .filter(|_| self.step.drawn.is_none_or(|packet| !is_drawn(packet)));
                let values = values.and_then(|contents| legend.values(seen.port, false, contents.as_bytes()));
                let handler = program(run_state, task)
                    .and_then(|program| legend.handler(program, task, Trigger::Message(seen.port)));
                let at = self.taken_at(run_state, task, seen.port).or(before);
                return (handler.or_else(|| legend.line(task, at?)), values);
            }
            Event::Rejected => before,
            Event::Resumed => Some(position(run_state, task)),
            Event::Granted
            | Event::TookOver
            | Event::Fenced
            | Event::Discarded(_)
            | Event::Interrupted
            | Event::Enqueued
            | Event::PartnerArrived
            | Event::PartnerAborted
            | Event::Confirmed => None,
        };
        (at.and_then(|at| legend.line(task, at)), None)
    }

    fn of_signal(&self, run_state: &RunState, task: usize, signal: &Signal) -> (Option<u32>, Option<String>) {
        let legend = &run_state.plan.legend;
        let handler = |trigger| legend.handler(program(run_state, task)?, task, trigger);
        match signal {
            Signal::Outcome(outcome) => {
                let asked = self.step.outcome.get(task).copied().flatten();
                let at = asked.or_else(|| self.step.before.get(task).copied());
                let values = match (outcome, at.and_then(|at| self.asks(run_state, task, at))) {
                    (Outcome::Reply(contents), Some(port))
                        if self.step.drawn.is_none_or(|packet| packet.port != port) =>
                    {
                        legend.values(port, true, contents.as_bytes())
                    }
                    _ => None,
                };
                (at.and_then(|at| legend.line(task, at)), values)
            }
            Signal::Interrupt(Call::Message(delivery)) => {
                (handler(Trigger::Message(delivery.from.port)), None)
            }
            Signal::Interrupt(Call::Timer(timer)) => (handler(Trigger::Timer(*timer)), None),
            Signal::Interrupt(Call::Fenced) => (handler(Trigger::Fenced), None),
            _ => (None, None),
        }
    }

    /// The statement of this step that sends, answers or reaches what an observation reports.
    fn carried_out(&mut self, run_state: &RunState, task: usize, seen: &Observation) -> Option<Address> {
        let program = program(run_state, task)?;
        let peers = run_state.plan.table.port(seen.port)?.peers(TaskId::from_index(task)).count();
        let begun = self.step.begun.get_mut(task)?;
        let mut doing = begun.iter_mut().filter_map(|(at, told)| {
            let op = operations(program, *at).find(|op| does(op, seen.event, seen.port))?;
            // A statement sends to one task, or to all peers. Further observations belong to the next statement.
            let most =
                if matches!(op, Op::Send { to, .. } if !matches!(to, Target::One(_))) { peers } else { 1 };
            (*told < most).then_some((*at, told))
        });
        let (at, told) = doing.next()?;
        *told += 1;
        Some(at)
    }

    /// The last statement that takes messages of a port, begun in this step or before it.
    fn taken_at(&self, run_state: &RunState, task: usize, on: PortId) -> Option<Address> {
        let program = program(run_state, task)?;
        let takes = |op: &Op| matches!(op, Op::Get { port, .. } if port.is_none_or(|port| port == on));
        let begun = self.step.begun.get(task)?.iter().rev().map(|&(at, _)| at);
        begun.into_iter().find(|&at| operations(program, at).any(takes))
    }

    /// The port on which the statement at an address sends.
    fn asks(&self, run_state: &RunState, task: usize, at: Address) -> Option<PortId> {
        let program = program(run_state, task)?;
        let sends = |op: &Op| match op {
            Op::Send { port, .. } => Some(*port),
            _ => None,
        };
        let here = program.code.get(usize::from(at)).and_then(sends);
        here.or_else(|| operations(program, at).find_map(sends))
    }
}

/// The operations of the statement that begins at an address.
fn operations(program: &Program, at: Address) -> impl Iterator<Item = &Op> {
    program.code.iter().skip(usize::from(at) + 1).take_while(|op| **op != Op::Statement)
}

/// Whether an operation causes this event on this port.
fn does(op: &Op, event: Event, on: PortId) -> bool {
    match (event, op) {
        (Event::Sent, Op::Send { port, .. })
        | (Event::Reached, Op::Arrive { port, .. })
        | (Event::Replied, Op::ReplyOwed { port, .. } | Op::ReplyFor { port, .. }) => *port == on,
        (Event::Replied, Op::Reply { .. }) => true,
        _ => false,
    }
}
