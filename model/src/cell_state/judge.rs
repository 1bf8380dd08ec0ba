//! The specification state of a cell, and the functions that judge its properties.

use super::body::{Activation, Does, says};
use super::plan::{CellProperty, CellScenario, Goal};
use super::predicates::PredicateState;
use super::{CellState, Effect};
use crate::state::Violation;
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{
    Call, Class, CommTask, Control, Delivery, Event, Fault, Kind, NodeId, Observation, Outcome, Packet,
    PortId, Reason, Request, Seq24, Signal, TaskId, Ticks, Usage,
};

/// Identifies a message: its source, and its sequence number among the source's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Name {
    pub source: TaskId,
    pub number: Seq24,
}

impl Name {
    pub fn of(delivery: &Delivery) -> Self {
        Self { source: delivery.from.source, number: delivery.from.id.sequence }
    }
}

/// The specification state: what the judge must remember, but no task of the cell can see.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct SpecStates {
    /// The true remaining times of messages, in ticks.
    pub remaining: Vec<(Name, u8)>,
    /// A bit mask for each source: bit `i` says that the source's message `next - 1 - i` was handed over.
    pub handed: Vec<u16>,
    /// A bit mask for each source, laid out as `handed`: the commands of which the source was told that they did not run.
    pub denied: Vec<u16>,
    /// For each port of the task watched for fairness, how often its first message was bypassed.
    pub bypassed: Vec<u8>,
    /// How often a waiting message was rejected: receiver, port, message, count.
    pub refused: Vec<(TaskId, PortId, Name, u8)>,
    /// For each task, the number of signals that it got since the last tick.
    pub signals: Vec<u8>,
    /// The facts that checks ask about and that no state machine keeps.
    pub told: PredicateState,
    /// The newest epoch in which a task became active.
    pub begun: u8,
    /// Bit `i`: the present incarnation of node `i` has heard of the epochs. Kept only if nodes can crash.
    pub heard: u8,
    /// The newest epoch of an order that the actuator has received.
    pub ordered: u8,
}

impl SpecStates {
    pub fn new(plan: &CellScenario) -> Self {
        let ports = plan.fair().map_or(0, |(task, ..)| plan.cell.ports_of(task).len());
        let tasks = plan.tasks.len();
        Self {
            handed: vec![0; tasks],
            denied: vec![0; tasks],
            bypassed: vec![0; ports],
            signals: vec![0; tasks],
            told: PredicateState::new(plan),
            begun: plan.epoch,
            ordered: plan.epoch,
            ..Self::default()
        }
    }

    pub fn tick(&mut self) {
        self.remaining.retain_mut(|(_, left)| {
            *left -= 1;
            *left > 0
        });
        self.signals.fill(0);
    }
}

/// Whether `epoch` comes after `than`, even if the epochs have wrapped. This does not use the state machine's comparison,
/// because that is what is tested.
const fn is_later(epoch: u8, than: u8) -> bool {
    epoch.wrapping_sub(than).cast_signed() > 0
}

impl CellState {
    /// Records that a task makes an API call, and for what it then waits.
    pub(super) fn asked(&mut self, task: usize, request: &Request) {
        self.note_asked(TaskId::from_index(task), request);
        let names_ports = self.plan.names_ports();
        let body = &mut self.bodies[task];
        if *request == Request::Return && body.activations.len() > 1 {
            body.activations.pop();
            return;
        }
        if *request == Request::Abandon {
            body.activations.truncate(1);
        }
        let Some(activation) = body.top_mut() else { return };
        let (does, get, port) = match *request {
            Request::Send { port, .. } | Request::Arrive { port, .. } => (Does::Waits, false, Some(port)),
            Request::Get { port, .. } => (Does::Waits, true, port),
            Request::Delay { .. }
            | Request::Boundary
            | Request::Lease
            | Request::Cancel
            | Request::Abandon => (Does::Waits, false, None),
            Request::Work => (Does::Works, false, None),
            _ => return,
        };
        let named = names_ports || get;
        (activation.does, activation.get, activation.port) = (does, get, port.filter(|_| named));
        self.entitle(task, request);
    }

    /// Records how long the wait of a task's API call may last.
    fn entitle(&mut self, task: usize, request: &Request) {
        let Some(slack) = self.plan.waits() else { return };
        let at = TaskId::from_index(task);
        let own = |port: PortId| self.plan.cell.port(port).and_then(|p| p.party(at)).map(|p| p.time_out);
        let limit = match *request {
            Request::Send { port, time_out, .. } | Request::Arrive { port, time_out, .. } => {
                own(port).map(|declared| time_out.map_or(declared, |wanted| wanted.min(declared)))
            }
            Request::Get { time_out, .. } => time_out,
            Request::Delay { length, .. } => Some(length),
            Request::Boundary => Some(Ticks::ZERO),
            _ => None,
        };
        let left = limit.filter(|l| *l != Ticks::FAR).map_or(Activation::FOREVER, |limit| {
            let whole = limit.0 + 1 + u64::from(slack);
            u8::try_from(whole).unwrap_or(Activation::FOREVER).min(Activation::FOREVER - 1)
        });
        if let Some(activation) = self.bodies[task].top_mut() {
            activation.left = left;
        }
    }

    /// Judges a signal to a task: the task must wait for it, and the signal must be allowed now.
    pub(super) fn told(&mut self, task: usize, signal: &Signal) -> Result<(), Violation> {
        self.count_signal(task)?;
        let top = self.bodies[task].top();
        let waits = top.does == Does::Waits;
        let scripted = self.leave(task, ScriptInput::Signal(*signal));
        let plan = std::sync::Arc::clone(&self.plan);
        match signal {
            Signal::Interrupt(call) => {
                self.judge_interrupt(task, call)?;
                if let Call::Message(delivery) = call {
                    self.handed_over(delivery)?;
                    self.forget(task, delivery);
                }
                let rank = self.rank_of_handler(task, call);
                self.bodies[task].hear(signal);
                if let Some(activation) = self.bodies[task].top_mut() {
                    activation.rank = rank;
                }
                return self.reach(Goal::Nested, self.bodies[task].activations.len() > 2);
            }
            Signal::Message(delivery) => {
                self.handed_over(delivery)?;
                self.judge_bypass(task, delivery)?;
                self.forget(task, delivery);
                self.bodies[task].hear(signal);
                return if waits { Ok(()) } else { Err(Violation::SecondOutcome) };
            }
            // A fault after a REPLY ends no wait. Such a fault only reports that the reply came too late.
            Signal::Fault(Fault::Late | Fault::NothingToAnswer) if top.does == Does::Serves => return Ok(()),
            Signal::Accepted(_) if top.does == Does::Serves => return Ok(()),
            Signal::Accepted(_) if matches!(top.does, Does::Free) => return Ok(()),
            Signal::Accepted(_) if top.does == Does::Works => {}
            // A task with a script handles the fault itself, or ends because of it.
            Signal::Fault(_) if scripted => {
                if waits {
                    self.bodies[task].resume();
                }
                return Ok(());
            }
            Signal::Fault(_) => return Err(Violation::Faulted),
            Signal::Outcome(outcome) => {
                let right = match outcome {
                    Outcome::Reply(contents) => *contents == says(top.question, &plan),
                    Outcome::Refused
                    | Outcome::TimedOutUnsent
                    | Outcome::TimedOutUnknown
                    | Outcome::PeerRestarted => true,
                };
                let answered = matches!(outcome, Outcome::Reply(_));
                let port = top.port;
                self.spec_states.told.ended(TaskId::from_index(task), port, answered);
                if waits && !right && !scripted && self.plan.waits().is_some() {
                    return Err(Violation::WrongAnswer);
                }
                if !answered && port.is_some_and(|port| self.plan.watches(CellProperty::Served { port })) {
                    return Err(Violation::NotServed);
                }
                self.reach(Goal::Answered, answered)?;
                self.reach(Goal::Refused, *outcome == Outcome::Refused)?;
                self.reach(Goal::Unsent, *outcome == Outcome::TimedOutUnsent)?;
                if matches!(outcome, Outcome::Refused | Outcome::TimedOutUnsent) {
                    self.deny(task)?;
                }
            }
            Signal::Answers { port, answers } => {
                self.judge_answers(task, *port, answers.answered)?;
                let every = answers.asked == answers.answered;
                self.spec_states.told.ended(TaskId::from_index(task), Some(*port), every);
                let all = answers.asked == answers.answered && answers.asked.count_ones() > 1;
                self.reach(Goal::AllAnswered, all)?;
            }
            Signal::TimeOut(_) => self.judge_delay(&top)?,
            Signal::Nothing
            | Signal::Accepted(_)
            | Signal::Released { .. }
            | Signal::GaveUp { .. }
            | Signal::Granted(_)
            | Signal::Cancelled => {}
        }
        if !waits && top.does != Does::Works {
            return Err(Violation::SecondOutcome);
        }
        self.bodies[task].resume();
        Ok(())
    }

    /// Judges a set of answers: each task that is marked as answered must have answered the task's present question.
    fn judge_answers(&self, task: usize, port: PortId, answered: u64) -> Result<(), Violation> {
        if self.plan.waits().is_none() || self.bodies[task].actor.is_some() {
            return Ok(());
        }
        let machine = self.nodes[self.node_state_of(task)].node.task(TaskId::from_index(task));
        let parties = self.plan.cell.port(port).map_or(&[][..], |port| &port.parties);
        let question = says(self.bodies[task].top().question, &self.plan);
        let wrong = parties.iter().enumerate().any(|(i, party)| {
            let said = machine.and_then(|m| m.answer_of(port, party.task));
            answered >> i & 1 == 1 && said != Some(&question)
        });
        if wrong { Err(Violation::WrongAnswer) } else { Ok(()) }
    }

    /// Judges the end of a delay: no tick of it may be left. Judges only if every node counts every tick as it passes.
    fn judge_delay(&self, activation: &Activation) -> Result<(), Violation> {
        let Some(slack) = self.plan.waits() else { return Ok(()) };
        let exact = self.plan.faults.drift == 0 && self.plan.faults.late == 0;
        // `left` still includes the tick that is passing, and the extra tick that a wait may last.
        let early = activation.does == Does::Waits
            && activation.left != Activation::FOREVER
            && activation.left > slack + 2;
        if exact && early { Err(Violation::TooEarly) } else { Ok(()) }
    }

    fn count_signal(&mut self, task: usize) -> Result<(), Violation> {
        if let Some(most) = self.plan.zeno() {
            let count = &mut self.spec_states.signals[task];
            *count += 1;
            if *count > most {
                return Err(Violation::Zeno);
            }
        }
        Ok(())
    }

    fn reach(&self, goal: Goal, reached: bool) -> Result<(), Violation> {
        if reached && self.plan.watches(CellProperty::Reach(goal)) { Err(Violation::Reached) } else { Ok(()) }
    }

    /// Judges a delivery: the message must have time left, and must not have been handed over before.
    fn handed_over(&mut self, delivery: &Delivery) -> Result<(), Violation> {
        self.reach(Goal::Left, true)?;
        let name = Name::of(delivery);
        if self.plan.watches(CellProperty::FencedOrders) {
            let said = delivery.contents.as_bytes().first().copied().unwrap_or(0);
            if is_later(self.spec_states.ordered, said) {
                return Err(Violation::OldOrder);
            }
            self.spec_states.ordered = said;
        }
        if self.plan.stale().is_some() && !self.spec_states.remaining.iter().any(|(n, _)| *n == name) {
            return Err(Violation::Stale);
        }
        let once = self.plan.watches(CellProperty::AtMostOnce);
        if once || self.plan.watches(CellProperty::DidNotRun) {
            let back = self.next_sequence(name.source.index()).steps_from(name.number);
            let bit = 1_u16.checked_shl(back.saturating_sub(1)).ok_or(Violation::Overflow)?;
            let handed = &mut self.spec_states.handed[name.source.index()];
            if once && *handed & bit != 0 {
                return Err(Violation::ExecutedTwice);
            }
            if self.spec_states.denied[name.source.index()] & bit != 0 {
                return Err(Violation::RanAnyway);
            }
            *handed |= bit;
        }
        Ok(())
    }

    /// Records that a task was told that its last command did not run, and judges whether this is true.
    fn deny(&mut self, task: usize) -> Result<(), Violation> {
        if !self.plan.watches(CellProperty::DidNotRun) {
            return Ok(());
        }
        self.spec_states.denied[task] |= 1;
        if self.spec_states.handed[task] & 1 != 0 { Err(Violation::RanAnyway) } else { Ok(()) }
    }

    /// Records a message that was sent.
    pub(super) fn sent(&mut self, effect: &Effect) {
        let Effect::Seen(_, Some(source), Observation { event: Event::Sent, number, remaining, .. }) =
            *effect
        else {
            return;
        };
        if let Some(slack) = self.plan.times_messages() {
            let left = u8::try_from(remaining.0).unwrap_or(u8::MAX).saturating_add(slack);
            self.spec_states.remaining.push((Name { source, number: Seq24::new(number) }, left));
        }
        self.spec_states.handed[source.index()] <<= 1;
        self.spec_states.denied[source.index()] <<= 1;
    }

    /// Records and judges an observation of a communication task or a transit buffer.
    pub(super) fn seen(&mut self, at: Option<TaskId>, seen: &Observation) -> Result<(), Violation> {
        match (at, seen.event) {
            (Some(task), event) => self.seen_at_task(task, event, seen),
            (None, Event::Discarded(_)) if self.plan.watches(CellProperty::Served { port: seen.port }) => {
                Err(Violation::NotServed)
            }
            (None, _) => Ok(()),
        }
    }

    fn seen_at_task(&mut self, task: TaskId, event: Event, seen: &Observation) -> Result<(), Violation> {
        let name = Name { source: seen.peer, number: Seq24::new(seen.number) };
        let this =
            |entry: &(TaskId, PortId, Name, u8)| (entry.0, entry.1, entry.2) == (task, seen.port, name);
        match event {
            Event::Discarded(Reason::Duplicate | Reason::Unexpected) => Ok(()),
            Event::Discarded(_) => {
                self.reach(Goal::Left, true)?;
                self.spec_states.refused.retain(|entry| !this(entry));
                let served = CellProperty::Served { port: seen.port };
                if self.plan.watches(served) { Err(Violation::NotServed) } else { Ok(()) }
            }
            Event::Rejected => self.refused(task, seen.port, name),
            Event::Fenced => self.reach(Goal::Fenced, true),
            Event::Enqueued if self.plan.watches(CellProperty::FencedOrders) => {
                if is_later(self.arriving, self.spec_states.ordered) {
                    self.spec_states.ordered = self.arriving;
                }
                Ok(())
            }
            Event::Granted | Event::TookOver if self.plan.watches(CellProperty::OneActive) => {
                self.judge_epoch(task, seen.number)
            }
            _ => Ok(()),
        }
    }

    /// Judges the epoch in which a task becomes active: it must be newer than all epochs in which any task was active. A
    /// new incarnation that has heard of no epoch is exempt: all orders of those epochs end before it can take over (D80).
    fn judge_epoch(&mut self, task: TaskId, epoch: u32) -> Result<(), Violation> {
        let knows = self.knows_epochs(self.node_state_of(task.index()));
        let Ok(epoch) = u8::try_from(epoch) else { return Err(Violation::OldEpoch) };
        let fresh = is_later(epoch, self.spec_states.begun);
        if fresh && (knows || self.guesses_above()) {
            self.spec_states.begun = epoch;
        }
        if fresh || !knows { Ok(()) } else { Err(Violation::OldEpoch) }
    }

    /// Whether a node knows the epochs: the node never restarted, or another node has told it about them since.
    fn knows_epochs(&self, place: usize) -> bool {
        self.nodes[place].incarnation.0 == 0 || self.spec_states.heard >> place & 1 == 1
    }

    /// Whether a restarted node surely begins in an unused epoch: not if the plan begins at another epoch than zero.
    fn guesses_above(&self) -> bool {
        self.plan.epoch == 0
    }

    /// Judges a packet that comes out of a link, and records whether the packet tells the node about the epochs.
    pub(super) fn judge_arrival(&mut self, to: NodeId, packet: &Packet) -> Result<(), Violation> {
        if self.plan.incarnations() && self.plan.watches(CellProperty::OneActive) {
            // An answer to an earlier incarnation tells the present incarnation nothing.
            let told =
                packet.kind != Kind::Response || packet.id.incarnation == self.nodes[to.index()].incarnation;
            let speaker = self.node_state_of(packet.source.index());
            let told = told && (self.guesses_above() || self.knows_epochs(speaker));
            self.spec_states.heard |= u8::from(told) << to.index();
        }
        let home = self.plan.cell.location(packet.destination) == Some(to);
        let word = packet.kind == Kind::Control && packet.control() == Some(Control::RefusedOnTheWay);
        self.reach(Goal::RefusedOnTheWay, home && word)
    }

    /// Judges a node's step: its transit buffer must not keep a status and drop a command for lack of space (D60).
    ///
    /// Each step offers the buffer one packet (several only if retransmissions are due at a tick, and these are commands).
    /// So every status that it holds or has sent after the step was in the buffer when it dropped the command.
    pub(super) fn judge_step(&self, i: usize, effects: &[Effect]) -> Result<(), Violation> {
        if !self.plan.watches(CellProperty::Eviction) {
            return Ok(());
        }
        let cell = &self.plan.cell;
        let dropped = |effect: &Effect| {
            let Effect::Seen(_, None, seen) = effect else { return false };
            let for_space = matches!(seen.event, Event::Discarded(Reason::Refused | Reason::Evicted));
            let port = cell.port(seen.port);
            let command = port.is_some_and(|p| p.decl.class == Class::Command);
            // Only tasks that receive on this node count, because answers and refusals travel towards senders.
            let receives = |usage: Usage| matches!(usage, Usage::Receive | Usage::Response);
            let asks = port.and_then(|p| p.party(seen.peer)).is_some_and(|party| receives(party.usage));
            let delay = cell.location(seen.peer).and_then(|to| cell.path_bound(NodeId::from_index(i), to));
            for_space && command && asks && delay.is_some_and(|delay| seen.remaining > delay)
        };
        if !effects.iter().any(dropped) {
            return Ok(());
        }
        let held = self.nodes[i].node.parts().transit.waiting();
        let left = effects.iter().filter_map(|e| if let Effect::Sent(_, p) = e { Some(p) } else { None });
        let status = held.iter().chain(left).any(|packet| packet.class == Class::Status);
        if status { Err(Violation::CommandEvicted) } else { Ok(()) }
    }

    /// Judges all waits after a tick: no wait may outlast its time_out.
    pub(super) fn judge_waits(&mut self) -> Result<(), Violation> {
        if self.plan.waits().is_none() {
            return Ok(());
        }
        for task in 0..self.bodies.len() {
            if !self.nodes[self.node_state_of(task)].up {
                continue;
            }
            let body = &mut self.bodies[task];
            let last = body.activations.len() - 1;
            for (i, activation) in body.activations.iter_mut().enumerate() {
                if activation.does != Does::Waits || activation.left == Activation::FOREVER {
                    continue;
                }
                // A task whose wait a handler interrupted learns only when the handler returns that the wait has ended.
                if activation.left == 0 && i == last {
                    return Err(Violation::NoOutcome);
                }
                activation.left = activation.left.saturating_sub(1);
            }
        }
        Ok(())
    }

    /// Judges the properties of a single state.
    pub(super) fn judge_state(&self) -> Result<(), Violation> {
        let machines = self.nodes.iter().filter(|s| s.up).flat_map(|s| &s.node.parts().tasks);
        let mut acting = machines.filter(|task| task.epoch().is_some() && task.is_active());
        if self.plan.watches(CellProperty::OneActive) && acting.clone().count() > 1 {
            return Err(Violation::BothActive);
        }
        self.reach(Goal::TookOver, acting.any(|task| task.task() == TaskId(1)))?;
        self.judge_checks()?;
        self.judge_held()?;
        if !self.plan.watches(CellProperty::Reach(Goal::BuffersFull)) {
            return Ok(());
        }
        let full = |node: NodeId, next: NodeId| {
            let transit = &self.nodes[node.index()].node.parts().transit;
            transit.is_full() && transit.view().next == [next]
        };
        let stuck = self.links.iter().any(|&(a, b, _)| full(a, b) && full(b, a));
        self.reach(Goal::BuffersFull, stuck && self.in_flight.is_empty())
    }

    /// Judges queued messages: none may have more time left than its sender still waits, or stay queued after that wait.
    fn judge_held(&self) -> Result<(), Violation> {
        let watch = |watch| self.plan.watches(watch);
        let (longer, at_all) = (watch(CellProperty::TimeToLive), watch(CellProperty::Expires));
        if !longer && !at_all {
            return Ok(());
        }
        let tasks = self.nodes.iter().filter(|s| s.up).flat_map(|s| &s.node.parts().tasks);
        for task in tasks {
            let ports = self.plan.cell.ports_of(task.task()).iter();
            let held =
                ports.filter_map(|&port| task.queue_view(port, usize::MAX)).flat_map(|view| view.queue);
            for entry in held.map(|held| held.entry) {
                let name = Name { source: entry.source, number: entry.id.sequence };
                let left =
                    self.spec_states.remaining.iter().find(|(n, _)| *n == name).map_or(0, |&(_, left)| left);
                if longer && entry.remaining > Ticks(left.into()) {
                    return Err(Violation::TtlExtended);
                }
                if at_all && left == 0 {
                    return Err(Violation::NotExpired);
                }
            }
        }
        Ok(())
    }

    pub(super) fn next_sequence(&self, task: usize) -> Seq24 {
        let node_state = &self.nodes[self.node_state_of(task)];
        let machine = if node_state.up { node_state.node.task(TaskId::from_index(task)) } else { None };
        machine.map_or(self.sequences[task], CommTask::next_sequence)
    }

    pub(super) fn is_quiescent(&self) -> bool {
        self.forced().is_empty() && !self.nodes.iter().any(|s| s.node.is_busy())
    }
}
