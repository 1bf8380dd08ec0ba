//! The unpacked state of a world: nodes with one task each, packets in flight, fault budgets and specification state.
//!
//! A world is only working memory. States are packed bytes: [`World::load`] unpacks one, a step changes it, and
//! [`World::store`] packs the result. Packed numbers are relative: remaining times, rounds counted from the least round in
//! use, sequence numbers counted back from the next one (D51).

use crate::cell_state::{Heard, NodeState};
use crate::network::{Codec, IN_FLIGHT_BYTES, InFlight};
use crate::scenario::{Behaviour, Scenario, Watch};
use crate::spec_state::{Judge, SpecState, question};
use crate::state::Violation;

use imrs_protocol::{
    Class, Event, Kind, MessageId, Node, NodeId, NodeInput, NodeOutbox, Observation, Outcome, Packet, Reason,
    Request, Round, Seq24, Signal, Target, TaskId, TaskState, Ticks,
};
use std::sync::Arc;

mod canon;
mod members;
mod timing;
mod turns;

pub(crate) use canon::Form;
use canon::FromBase;

/// A transition of a world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// A tick passes on every node and for every packet.
    Tick,
    /// A tick passes, and the timer of this node fires only at the next tick.
    Late(u8),
    /// The packet at this position in the state arrives.
    Deliver(u8),
    /// A packet arrives: its position, and how many ticks more than the link's bound it is charged.
    Overcharge(u8, u8),
    /// The packet at this position is lost.
    Lose(u8),
    /// The packet at this position arrives, and a copy of it stays in flight.
    Duplicate(u8),
    /// The task makes the API call that its behaviour allows.
    Act(u8),
    /// A receiver answers the command that it holds.
    Answer(u8),
    /// The node crashes.
    Crash(u8),
    /// The node restarts, in its next incarnation.
    Restart(u8),
    /// The faults end: from here on every task is eager and acts as soon as it can.
    Heal,
}

/// The unpacked state: nodes, packets in flight and specification state. Transitions change this form.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub scenario: Arc<Scenario>,
    /// Every node runs one task, with the same index. While the timer of a node is late, the node owes a tick.
    pub nodes: Vec<NodeState>,
    pub in_flight: Vec<InFlight>,
    pub spec_states: Vec<SpecState>,
    pub violation: Option<Violation>,
    pub loss: u8,
    pub dup: u8,
    pub crash: u8,
    /// How often a timer may still be late on this path.
    pub late: u8,
    /// Transitions since the last tick; counted only for [`Watch::Waits`].
    pub steps: u16,
    pub healed: bool,
    pub done: bool,
    /// For each port, the round to which the loaded rounds are relative.
    rounds: Vec<Round>,
    codec: Codec,
    effects: Effects,
    /// The packed nodes. A node that [`World::load`] did not unpack exists only in this form.
    blocks: Vec<Vec<u8>>,
    loaded: Vec<bool>,
    /// For each node, whether its turn is still open: it may step in this tick (see the module `turns`).
    open: Vec<bool>,
    /// The order in which the nodes take turns.
    order: Vec<usize>,
    /// The order of the members in the state that was packed last.
    pub named: Vec<usize>,
    /// What happened to each task in the last transition, for charts.
    pub log: Vec<(TaskId, Shown)>,
    pub keep_log: bool,
    /// A node on which all members of a meeting run, for copies of their states.
    together: Option<Node>,
}

/// How many packets a transit buffer holds. Few are enough, because a world empties its transit buffers at once.
const TRANSIT: u16 = 64;

/// What happened to a task in a step.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shown {
    /// The communication task of the task reported an event.
    Seen(Observation),
    /// The task got a signal.
    Signalled(Signal),
}

/// The packets that one step of a node sent, and what happened to tasks in the step.
#[derive(Clone, Debug, Default)]
struct Effects {
    sent: Vec<Packet>,
    signals: Vec<Signal>,
    seen: Vec<Observation>,
}

impl NodeOutbox for Effects {
    fn link(&mut self, _: NodeId, packet: Packet) {
        self.sent.push(packet);
    }
    fn signal(&mut self, _: TaskId, signal: Signal) {
        self.signals.push(signal);
    }
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.seen.push(observation);
    }
}

impl World {
    /// The initial state.
    pub fn new(scenario: &Arc<Scenario>) -> Self {
        let n = scenario.tasks();
        let place = |i: usize| {
            let mut place = NodeState::new(scenario.table(NodeId::from_index(i)), n, TRANSIT);
            place.node.parts_mut().tasks[0].set_ahead(&place.table, Ticks(scenario.clocks[i]));
            place
        };
        Self {
            nodes: (0..n).map(place).collect(),
            in_flight: Vec::new(),
            spec_states: scenario.behaviours.iter().map(|&b| SpecState::new(b)).collect(),
            violation: None,
            loss: scenario.budget.loss,
            dup: scenario.budget.dup,
            crash: scenario.budget.crash,
            late: scenario.timing.late,
            steps: 0,
            healed: false,
            done: false,
            rounds: vec![Round::default(); scenario.cell.ports().len()],
            codec: Codec::new(scenario),
            effects: Effects::default(),
            blocks: vec![Vec::new(); n],
            loaded: vec![true; n],
            open: vec![true; n],
            order: (0..n).collect(),
            named: (0..n).collect(),
            log: Vec::new(),
            keep_log: false,
            together: members::together(scenario),
            scenario: Arc::clone(scenario),
        }
    }

    fn n(&self) -> usize {
        self.nodes.len()
    }

    /// Lists the enabled transitions. Their order decides which of several shortest counterexamples is found.
    pub fn actions(&self, actions: &mut Vec<Action>) {
        if self.violation.is_some() || self.done {
            return;
        }
        if self.takes_turns() {
            self.actions_in_turns(actions);
        } else {
            self.free_actions(actions);
        }
    }

    /// Lists the transitions that are enabled without the reduction by turns.
    fn free_actions(&self, actions: &mut Vec<Action>) {
        for i in 0..self.n() {
            self.task_actions(i, actions);
        }
        for (i, carried) in self.in_flight.iter().enumerate() {
            let i = small(i);
            // Delivering one of two equal packets gives the same state as delivering the other.
            if i > 0 && self.in_flight[usize::from(i) - 1] == *carried {
                continue;
            }
            self.arrivals(i, actions);
            // No task can notice a loss before the packet's last tick on its link, unless the faults end first.
            let may_heal = matches!(self.scenario.watch, Watch::MeetAgain { .. });
            let last = may_heal || self.scenario.delay.is_none_or(|delay| carried.age == delay);
            if self.loss > 0 && !self.healed && (last || !self.scenario.reductions.lose_last) {
                actions.push(Action::Lose(i));
            }
        }
        self.crashes(actions);
        let oldest = self.in_flight.iter().map(|f| f.age).max();
        let arrived = self.scenario.delay.is_some_and(|delay| oldest.is_none_or(|age| age < delay));
        if arrived && !self.is_urgent() {
            self.ticks(actions);
        }
    }

    /// Lists the ways in which a packet may arrive.
    fn arrivals(&self, i: u8, actions: &mut Vec<Action>) {
        actions.push(Action::Deliver(i));
        if self.healed {
            return;
        }
        actions.extend((1..=self.scenario.timing.overcharge).map(|extra| Action::Overcharge(i, extra)));
        if self.dup > 0 {
            actions.push(Action::Duplicate(i));
        }
    }

    /// Lists the ways in which a tick may pass.
    fn ticks(&self, actions: &mut Vec<Action>) {
        actions.push(Action::Tick);
        if self.late > 0 && !self.healed {
            let punctual = (0..self.n()).filter(|&i| self.nodes[i].up && self.nodes[i].owed == 0);
            actions.extend(punctual.map(|i| Action::Late(small(i))));
        }
    }

    /// Lists crashes, restarts and the end of faults.
    fn crashes(&self, actions: &mut Vec<Action>) {
        if self.crash > 0 {
            for (i, place) in self.nodes.iter().enumerate() {
                let may =
                    matches!(self.scenario.behaviours[i], Behaviour::Receiver | Behaviour::Member { .. });
                if place.up && may {
                    actions.push(Action::Crash(small(i)));
                }
            }
        }
        for (i, place) in self.nodes.iter().enumerate() {
            if !place.up {
                actions.push(Action::Restart(small(i)));
            }
        }
        if matches!(self.scenario.watch, Watch::MeetAgain { .. }) && !self.healed {
            actions.push(Action::Heal);
        }
    }

    /// Whether some task must act before time passes.
    fn is_urgent(&self) -> bool {
        let mut acts = Vec::new();
        if self.scenario.hurry || self.healed {
            (0..self.n()).for_each(|i| self.task_actions(i, &mut acts));
        }
        !acts.is_empty()
    }

    fn task_actions(&self, i: usize, actions: &mut Vec<Action>) {
        if !self.nodes[i].up {
            return;
        }
        let spec_state = &self.spec_states[i];
        let running = self.task(i).is_idle();
        match self.scenario.behaviours[i] {
            Behaviour::Member { .. } | Behaviour::Sender { .. } => {
                if running
                    && (spec_state.left > 0
                        || (self.healed && matches!(self.scenario.behaviours[i], Behaviour::Member { .. })))
                {
                    actions.push(Action::Act(small(i)));
                }
            }
            Behaviour::Receiver if spec_state.serving.is_some() => actions.push(Action::Answer(small(i))),
            Behaviour::Receiver => {
                if running {
                    actions.push(Action::Act(small(i)));
                }
            }
        }
    }

    fn task(&self, i: usize) -> &imrs_protocol::CommTask {
        &self.nodes[i].node.parts().tasks[0]
    }

    /// Whether all tasks have finished their work, and no packet is in flight.
    pub fn is_finished(&self) -> bool {
        let rests = |i: usize| self.task(i).is_idle() && self.spec_states[i].left == 0;
        self.in_flight.is_empty() && (0..self.n()).all(rests)
    }

    /// Makes a transition. If it violates the watched property, that becomes the state's violation.
    pub fn apply(&mut self, action: Action) {
        if self.takes_turns() {
            self.take_turn(action);
        }
        self.steps += u16::from(self.scenario.watch == Watch::Waits);
        let result = match action {
            Action::Tick => self.tick(None),
            Action::Late(i) => {
                self.late -= 1;
                self.tick(Some(usize::from(i)))
            }
            Action::Deliver(i) => {
                let carried = self.in_flight.remove(usize::from(i));
                self.deliver(carried, 0)
            }
            Action::Overcharge(i, extra) => {
                let carried = self.in_flight.remove(usize::from(i));
                self.deliver(carried, extra)
            }
            Action::Lose(i) => {
                self.in_flight.remove(usize::from(i));
                self.loss -= 1;
                Ok(())
            }
            Action::Duplicate(i) => {
                self.dup -= 1;
                let carried = self.in_flight[usize::from(i)];
                self.deliver(carried, 0)
            }
            Action::Act(i) => self.act(usize::from(i)),
            Action::Answer(i) => self.answer(usize::from(i)),
            Action::Crash(i) => {
                let place = &mut self.nodes[usize::from(i)];
                (place.up, place.owed) = (false, 0);
                let spec_state = &mut self.spec_states[usize::from(i)];
                (spec_state.serving, spec_state.open) = (None, None);
                self.crash -= 1;
                Ok(())
            }
            Action::Restart(i) => {
                let place = &mut self.nodes[usize::from(i)];
                place.restart(TRANSIT);
                place.node.parts_mut().tasks[0].walk(&place.table, &mut FromBase(self.rounds[0]));
                self.spec_states[usize::from(i)].missed = self.left_by_others(usize::from(i));
                Ok(())
            }
            Action::Heal => {
                self.healed = true;
                for spec_state in &mut self.spec_states {
                    spec_state.since_heal = 0;
                }
                Ok(())
            }
        };
        let result = result.and_then(|()| self.judge_quiet()).and_then(|()| self.judge_progress());
        if let Err(violation) = result {
            self.violation = Some(violation);
        }
    }

    /// Lets a packet arrive. It is charged the link's bound and `extra` ticks.
    fn deliver(&mut self, mut carried: InFlight, extra: u8) -> Result<(), Violation> {
        self.wrap_around(&mut carried);
        let to = carried.packet.destination.index();
        let from = NodeId::from_index(carried.packet.source.index());
        if !self.nodes[to].up {
            return Ok(());
        }
        self.catch_up(to)?;
        match self.nodes[to].hears(from, carried.incarnation) {
            Heard::Old => return Ok(()),
            Heard::Known => {}
            Heard::New => self.step(to, Ticks::ZERO, NodeInput::PeerRestarted(from))?,
        }
        let charge = Ticks(u64::from(self.scenario.delay.unwrap_or(0)) + u64::from(extra));
        self.step(to, Ticks::ZERO, NodeInput::Packet { from, packet: carried.packet, charge })
    }

    fn act(&mut self, i: usize) -> Result<(), Violation> {
        self.catch_up(i)?;
        let request = match self.scenario.behaviours[i] {
            Behaviour::Member { port, .. } => {
                self.spec_states[i].use_one();
                self.spec_states[i].open = Some(0);
                Request::Arrive { port, arguments: [0; 8], time_out: None }
            }
            Behaviour::Sender { port, .. } => {
                self.spec_states[i].use_one();
                self.spec_states[i].executed <<= 1;
                self.spec_states[i].open = Some(0);
                let contents = question(self.spec_states[i].left);
                Request::Send { port, to: Target::All, contents, time_out: None }
            }
            Behaviour::Receiver => Request::Get { port: None, source: None, time_out: None },
        };
        self.step(i, Ticks::ZERO, NodeInput::Request(TaskId::from_index(i), request))
    }

    fn answer(&mut self, i: usize) -> Result<(), Violation> {
        self.catch_up(i)?;
        let Some(to) = self.spec_states[i].serving.take() else { return Ok(()) };
        // The answer repeats the command's contents. These follow from the number of sends left, so that a mix-up shows.
        let asked = self.spec_states[to.source.index()].left;
        let back = self.next_sequence(to.source.index()).steps_from(to.id.sequence).saturating_sub(1);
        let contents = question(asked.saturating_add(u8::try_from(back).unwrap_or(u8::MAX)));
        self.step(i, Ticks::ZERO, NodeInput::Request(TaskId::from_index(i), Request::Reply { to, contents }))
    }

    fn next_sequence(&self, i: usize) -> Seq24 {
        self.task(i).next_sequence()
    }

    /// Lets `elapsed` ticks pass on one node, gives it an input, and judges the effects.
    fn step(&mut self, i: usize, elapsed: Ticks, input: NodeInput) -> Result<(), Violation> {
        let task = TaskId::from_index(i);
        self.spec_states[i].waits_in = match self.task(i).state() {
            TaskState::Waiting { round, .. } => Some(round),
            _ => None,
        };
        let takes_turns = self.takes_turns();
        let mut effects = std::mem::take(&mut self.effects);
        let NodeState { node, incarnation, .. } = &mut self.nodes[i];
        node.step(node.now() + elapsed, input, &mut effects);
        for packet in effects.sent.drain(..) {
            if self.scenario.watch == Watch::Stale
                && packet.kind == Kind::Send
                && packet.class == Class::Status
            {
                let ttl = self.scenario.cell.port(packet.port).map_or(0, |p| p.decl.time_out.0);
                self.spec_states[i].statuses.push((packet.id.sequence, u8::try_from(ttl).unwrap_or(u8::MAX)));
            }
            let fresh = takes_turns && !self.open[packet.destination.index()];
            self.in_flight.push(InFlight { packet, age: 0, incarnation: *incarnation, fresh });
        }
        if self.keep_log {
            self.log.extend(effects.seen.iter().map(|&seen| (task, Shown::Seen(seen))));
            self.log.extend(effects.signals.iter().map(|&signal| (task, Shown::Signalled(signal))));
        }
        let result = self.judge(task, &effects);
        effects.signals.clear();
        effects.seen.clear();
        self.effects = effects;
        imrs_protocol::invariants::check(self.task(i), &self.nodes[i].table)
            .map_err(|_| Violation::Invariant)?;
        result
    }

    fn judge(&mut self, at: TaskId, effects: &Effects) -> Result<(), Violation> {
        let mut spec_states = std::mem::take(&mut self.spec_states);
        let base = self.rounds.first().copied().unwrap_or_default();
        let mut judge = Judge {
            scenario: &self.scenario,
            spec_states: &mut spec_states,
            healed: self.healed,
            base,
            done: self.done,
        };
        let awaits = |task: TaskId| -> Option<(TaskId, MessageId)> {
            if self.nodes[task.index()].up { self.task(task.index()).awaits() } else { None }
        };
        let seen = effects.seen.iter().try_for_each(|seen| judge.observed(at, seen));
        let late = effects.signals.iter().any(|s| matches!(s, Signal::Outcome(o) if timed_out(o)));
        let answer_on_the_way =
            |carried: &InFlight| carried.packet.kind == Kind::Reply && carried.packet.destination == at;
        let current = self.in_flight.iter().any(|f| answer_on_the_way(f) && f.packet.id == self.last_id(at));
        // The node drops an answer whose remaining time is less than the link delay (D83).
        let kept = effects.seen.iter().any(|seen| {
            seen.event == Event::Discarded(Reason::ExpiredInTransit)
                && awaits(seen.peer).is_some_and(|(_, id)| id.sequence.get() == seen.number)
        });
        if (kept || (late && current)) && self.scenario.watch == Watch::Resolves {
            self.spec_states = spec_states;
            return Err(Violation::LateAnswer);
        }
        let signalled = seen
            .and_then(|()| effects.signals.iter().try_for_each(|signal| judge.signalled(at, signal, awaits)))
            .and_then(|()| judge.judge_round());
        let done = judge.done;
        self.done = done;
        self.spec_states = spec_states;
        signalled
    }

    /// The id of the message that a task sent last.
    fn last_id(&self, task: TaskId) -> MessageId {
        let sequence = self.next_sequence(task.index()).plus(Seq24::MODULUS - 1);
        MessageId { incarnation: self.nodes[task.index()].incarnation, sequence }
    }

    /// Judges [`Watch::Stranded`]. Only a state without packets in flight can violate this property.
    fn judge_quiet(&self) -> Result<(), Violation> {
        if self.scenario.watch != Watch::Stranded || !self.in_flight.is_empty() {
            return Ok(());
        }
        let all_reached = self.spec_states.iter().all(|g| g.announced != 0);
        let somebody_waits = (0..self.n()).any(|i| !self.task(i).is_idle());
        if all_reached && somebody_waits { Err(Violation::Stranded) } else { Ok(()) }
    }
}

const fn timed_out(outcome: &Outcome) -> bool {
    matches!(outcome, Outcome::TimedOutUnknown | Outcome::TimedOutUnsent)
}

fn small(i: usize) -> u8 {
    u8::try_from(i).unwrap_or(u8::MAX)
}

const _: () = assert!(IN_FLIGHT_BYTES < 256);
