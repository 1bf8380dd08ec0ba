//! The unpacked cell state: whole nodes with several tasks each, relays, links of limited capacity, drift.
//!
//! Like a `World`, a `CellState` is only working memory for packed states (`canon`). A node is the protocol's own [`Node`].
//! A [`plan::TaskPlan`] says what a task does, and a [`plan::CellProperty`] what is judged.

pub(crate) mod body;
pub(crate) mod canon;
pub(crate) mod chart;
mod fused;
mod history;
mod judge;
mod moves;
mod node_state;
mod order;
mod orders;
pub mod plan;
mod predicates;
mod room;
pub(crate) mod script;
mod search;
mod time;
mod walk;
mod wires;
pub mod worlds;

pub use chart::draw_cell_state;
pub(crate) use node_state::{Heard, NodeState};
pub use search::{CellModel, LiveCellState, explore_cell_state};

use crate::state::Violation;
use body::{Body, Does};
use history::History;
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{
    CommTask, Contents, Incarnation, Node, NodeId, NodeInput, Observation, Packet, Request, Round, Rules,
    Seq24, Signal, TaskId, Ticks, invariants,
};
use plan::{CellScenario, Errand};
use std::collections::VecDeque;
use std::sync::Arc;
use wires::Wires;

/// A transition of a cell state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Move {
    /// A tick passes. Two bits for each node say how it counts the tick: once, not at all, twice, or later.
    Tick(u16),
    /// A packet arrives: its position, and how many ticks above its link's bound it is charged.
    Deliver(u8, u8),
    /// The packet at this position is lost.
    Lose(u8),
    /// The packet at this position is duplicated on its link.
    Duplicate(u8),
    /// The task makes its next step.
    Act(u8),
    /// The task's handler sends its nested command.
    Nest(u8),
    /// The node crashes.
    Crash(u8),
    /// The node restarts, in its next incarnation.
    Restart(u8),
    /// A task of the node takes the queued input at this position.
    Take(u8, u8),
    /// The task's script gets this choice.
    Choose(u8, u8),
    /// An action of a task's script ends: the task, and the activation that began the action.
    Acted(u8, u8),
}

/// A packet that is in flight on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct InFlight {
    pub packet: Packet,
    /// The link's position among the plan's directed links.
    pub link: u8,
    /// The time since the packet entered the link, including its wait for a paused node.
    pub age: Ticks,
    /// The incarnation of the node that sent the packet over this link, as the packet's envelope says.
    pub incarnation: Incarnation,
}

/// The unpacked cell state: whole nodes, packets in flight, specification state. Transitions change this form.
#[derive(Clone, Debug)]
pub(crate) struct CellState {
    pub plan: Arc<CellScenario>,
    pub links: Vec<(NodeId, NodeId, u8)>,
    pub nodes: Vec<NodeState>,
    pub bodies: Vec<Body>,
    pub in_flight: Vec<InFlight>,
    pub spec_states: judge::SpecStates,
    pub faults: plan::Faults,
    /// How many packets each directed link took in this tick.
    pub used: Vec<u8>,
    pub violation: Option<Violation>,
    /// The rounds, by port, to which loaded rounds are relative. The next field has the sequence numbers, by task.
    pub rounds: Vec<Round>,
    pub sequences: Vec<Seq24>,
    /// What happened in the last transition, for charts.
    pub log: Vec<Effect>,
    pub keep_log: bool,
    /// Ticks that have passed since this field was last reset.
    pub passed: u32,
    spare: Vec<Effect>,
    /// The last contents byte of the arriving packet: the epoch, if the packet is an order.
    arriving: u8,
    /// The tasks whose scripts have inputs, in the order of each script's first input. Empty between transitions.
    ready: VecDeque<usize>,
    /// For each port, how far `rounds` has moved from the first round, at most [`FAR_BEHIND`]. Counted only in a cell
    /// whose nodes may restart.
    pub behind: Vec<u8>,
    /// The steps that scripts took, for the checker of cells, which goes on after a script's end; `None` in other searches.
    pub turns: Option<Vec<script::ScriptReaction>>,
    /// Whether inputs of a node's tasks queue, so that the search can let the tasks take them in every order (D170).
    orders: bool,
    /// The history of the run; `None` if the run is not followed from its start.
    history: Option<Box<History>>,
    /// Whether each step also checks the invariants of the state machines, and that unchanged checks kept their values.
    /// Only the search of a cell turns this off, for states that are not in its sample.
    pub is_sampled: bool,
    /// Whether times are symbolic (without a value): then fused steps are not compared, because a zone packs one state at a time.
    pub is_symbolic: bool,
}

/// What a node did in one step, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    Sent(NodeId, Packet),
    Signalled(TaskId, Signal),
    /// An observation at a node, by a task or (`None`) by the transit buffer.
    Seen(u8, Option<TaskId>, Observation),
}

/// A new incarnation this many rounds behind behaves like one farther behind, because rounds are only compared.
const FAR_BEHIND: u8 = 3;

/// The greatest number of fused steps in one transition: more steps would be a loop in which no time passes.
const FUSED: usize = 64;

impl CellState {
    /// The initial state.
    pub fn new(plan: &Arc<CellScenario>) -> Self {
        let mut cell_state = Self::unbegun(plan);
        let begun = (0..cell_state.bodies.len())
            .try_for_each(|t| cell_state.begin(t))
            .and_then(|()| cell_state.settle());
        // A message number in a script variable is absolute, so no canonical state can hold it (D51).
        let mut programs = plan.tasks.iter().filter_map(|task| task.script.as_ref());
        let absolute = programs.any(|program| program.names_messages());
        cell_state.violation = if absolute { Some(Violation::Overflow) } else { begun.err() };
        cell_state
    }

    /// The initial state for the checker of cells, which judges scripts itself and continues after a script has ended.
    pub(crate) fn of_cell(plan: &Arc<CellScenario>) -> Self {
        let mut cell_state = Self { orders: true, ..Self::waiting(plan) };
        let decided = plan.cell.cell().rules == Rules::default();
        if plan.history && decided {
            cell_state.history = Some(Box::new(History::new(plan, &cell_state.nodes)));
        }
        let tasks =
            (0..cell_state.bodies.len()).filter(|&task| !cell_state.leaves_out(task)).collect::<Vec<_>>();
        // The scripts of a node begin one by one, each with all its effects within the node (D170).
        let begun = tasks.into_iter().try_for_each(|task| cell_state.begin_whole(task));
        cell_state.violation = begun.err();
        cell_state
    }

    /// As [`of_cell`](Self::of_cell), but no script has begun yet.
    pub(crate) fn waiting(plan: &Arc<CellScenario>) -> Self {
        Self { turns: Some(Vec::new()), ..Self::unbegun(plan) }
    }

    /// Forgets the history, because packed states, which are loaded from here on, do not hold it.
    pub(crate) fn forget_history(&mut self) {
        self.history = None;
    }

    /// Restarts a node of a cell in its next incarnation, which counts rounds from the first round on. The scripts of the
    /// node have not begun: see [`begin_all`](Self::begin_all).
    pub(crate) fn restart_behind(&mut self, node: usize) -> Result<(), Violation> {
        let here = self.rounds.clone();
        for (round, behind) in self.rounds.iter_mut().zip(&self.behind) {
            *round = Round(round.0.wrapping_sub(u16::from(*behind)));
        }
        let result = self.restart(node);
        self.rounds = here;
        result
    }

    /// Whether states must record how far the rounds of a new incarnation would be behind.
    fn counts_behind(&self) -> bool {
        self.turns.is_some() && self.plan.incarnations()
    }

    fn unbegun(plan: &Arc<CellScenario>) -> Self {
        let n = plan.nodes();
        let links = plan.links();
        let node_state = |i: usize| {
            let table = plan.table(NodeId::from_index(i));
            NodeState { up: !plan.leaves_out(i), ..NodeState::new(table, n, plan.transit) }
        };
        let mut cell_state = Self {
            nodes: (0..n).map(node_state).collect(),
            bodies: plan.tasks.iter().map(Body::new).collect(),
            in_flight: Vec::new(),
            spec_states: judge::SpecStates::new(plan),
            faults: plan.faults,
            used: vec![0; links.len()],
            violation: None,
            rounds: vec![Round::default(); plan.cell.ports().len()],
            sequences: vec![Seq24::default(); plan.tasks.len()],
            log: Vec::new(),
            keep_log: false,
            passed: 0,
            spare: Vec::new(),
            arriving: 0,
            ready: VecDeque::new(),
            behind: vec![0; plan.cell.ports().len()],
            turns: None,
            orders: !plan.fused,
            history: None,
            is_sampled: true,
            is_symbolic: false,
            links,
            plan: Arc::clone(plan),
        };
        for i in 0..n {
            cell_state.set_clock(i);
            let NodeState { node, table, .. } = &mut cell_state.nodes[i];
            for task in &mut node.parts_mut().tasks {
                task.walk(table, &mut time::Epochs(plan.epoch));
            }
        }
        cell_state
    }

    fn set_clock(&mut self, node: usize) {
        let ahead = Ticks(self.plan.clocks[node]);
        let NodeState { node, table, .. } = &mut self.nodes[node];
        for task in &mut node.parts_mut().tasks {
            task.set_ahead(table, ahead);
        }
    }

    pub(crate) fn begin(&mut self, task: usize) -> Result<(), Violation> {
        if self.leave(task, ScriptInput::Begin) {
            return self.run_scripts();
        }
        let requests = Body::setup(&self.plan.tasks[task]);
        requests.into_iter().try_for_each(|request| self.ask(task, request))
    }

    pub fn node_state_of(&self, task: usize) -> usize {
        self.plan.cell.location(TaskId::from_index(task)).map_or(0, NodeId::index)
    }

    /// Whether a task is on a node that the search leaves out.
    fn leaves_out(&self, task: usize) -> bool {
        self.plan.leaves_out_task(TaskId::from_index(task))
    }

    /// Makes a transition. If it violates a watched property, that becomes the state's violation.
    pub fn apply(&mut self, step: Move) {
        let moved = self.carry_out(step).and_then(|()| self.run_scripts());
        let result = moved.and_then(|()| self.settle()).and_then(|()| self.judge_state());
        self.sort_inputs();
        if let Err(violation) = result {
            self.violation = Some(violation);
        }
    }

    fn carry_out(&mut self, step: Move) -> Result<(), Violation> {
        match step {
            Move::Tick(code) => self.tick(code),
            Move::Deliver(i, over) => {
                let carried = self.in_flight.remove(usize::from(i));
                self.faults.over -= over;
                self.deliver(carried, over)
            }
            Move::Lose(i) => {
                self.in_flight.remove(usize::from(i));
                if self.faults.loss != u8::MAX {
                    self.faults.loss -= 1;
                }
                Ok(())
            }
            Move::Duplicate(i) => {
                let copy = self.in_flight[usize::from(i)];
                self.in_flight.insert(usize::from(i), copy);
                self.faults.dup -= 1;
                Ok(())
            }
            Move::Act(task) => self.act(usize::from(task)),
            Move::Nest(task) => {
                let plan = Arc::clone(&self.plan);
                let task = usize::from(task);
                let requests = self.bodies[task].nest(&plan.tasks[task], &plan);
                requests.into_iter().try_for_each(|request| self.ask(task, request))
            }
            Move::Crash(i) => {
                self.faults.crash -= 1;
                self.note_crash(usize::from(i));
                self.crash(usize::from(i));
                Ok(())
            }
            Move::Restart(i) => {
                self.note_restart(usize::from(i));
                self.restart(usize::from(i))
            }
            Move::Take(i, at) => self.take(usize::from(i), usize::from(at)),
            Move::Choose(task, choice) => {
                self.leave(usize::from(task), ScriptInput::Chosen(u16::from(choice)));
                Ok(())
            }
            Move::Acted(task, activation) => {
                self.acted(usize::from(task), activation, true, 0);
                Ok(())
            }
        }
    }

    /// Completes a transition: packets leave buffers whose links have become free, and an eager task makes its next step if
    /// it is the only eager one. If several tasks are eager, the search chooses which one goes first.
    pub(crate) fn settle(&mut self) -> Result<(), Violation> {
        for _ in 0..FUSED {
            self.flush()?;
            let forced = self.forced();
            let [task] = forced[..] else { return Ok(()) };
            if self.bodies[task].actor.is_some() {
                return Ok(());
            }
            if !self.plan.fused || self.bodies[task].may_nest(&self.plan.tasks[task]) {
                return Ok(());
            }
            self.act(task)?;
            self.run_scripts()?;
        }
        Err(Violation::Zeno)
    }

    fn act(&mut self, task: usize) -> Result<(), Violation> {
        let plan = Arc::clone(&self.plan);
        let serves = self.bodies[task].top().does == Does::Serves;
        let requests = self.bodies[task].act(TaskId::from_index(task), &plan);
        for request in requests {
            let request = self.in_epoch(task, request);
            self.ask(task, request)?;
        }
        if serves && self.bodies[task].activations.len() == 1 && self.bodies[task].top().does == Does::Serves
        {
            self.bodies[task].resume();
        }
        Ok(())
    }

    /// Writes the task's present epoch into an order that the task gives.
    fn in_epoch(&self, task: usize, request: Request) -> Request {
        let machine = self.nodes[self.node_state_of(task)].node.task(TaskId::from_index(task));
        match (request, machine.and_then(CommTask::epoch)) {
            (Request::Send { port, to, time_out, .. }, Some(epoch)) => {
                let contents = Contents::new(&[epoch]).unwrap_or_default();
                Request::Send { port, to, contents, time_out }
            }
            _ => request,
        }
    }

    /// Whether the task can step by itself now. A task gives orders only while it is active.
    fn may_act(&self, task: usize) -> bool {
        let (body, plan) = (&self.bodies[task], &self.plan.tasks[task]);
        let machine = self.nodes[self.node_state_of(task)].node.task(TaskId::from_index(task));
        let orders = matches!(plan.errand, Errand::Order { .. }) && body.top().does == Does::Free;
        body.may_act(plan) && (!orders || machine.is_some_and(CommTask::is_active))
    }

    fn ask(&mut self, task: usize, request: Request) -> Result<(), Violation> {
        self.asked(task, &request);
        self.step(self.node_state_of(task), NodeInput::Request(TaskId::from_index(task), request))
    }

    pub(crate) fn deliver(&mut self, carried: InFlight, over: u8) -> Result<(), Violation> {
        let (from, to, bound) = self.links[usize::from(carried.link)];
        let node_state = &mut self.nodes[to.index()];
        if !node_state.up {
            return Ok(());
        }
        match node_state.hears(from, carried.incarnation) {
            Heard::Old => return Ok(()),
            Heard::Known => {}
            Heard::New => self.step(to.index(), NodeInput::PeerRestarted(from))?,
        }
        // A wait for a paused node is charged, too: kernels stamp a packet when it arrives (D50).
        let charge = carried.age.max(Ticks(u64::from(bound))) + Ticks(u64::from(over));
        self.judge_arrival(to, &carried.packet)?;
        self.arriving = carried.packet.contents.as_bytes().last().copied().unwrap_or(0);
        self.step(to.index(), NodeInput::Packet { from, packet: carried.packet, charge })
    }

    /// Steps one node, puts the node's packets on its links, and judges the effects.
    pub(crate) fn step(&mut self, i: usize, input: NodeInput) -> Result<(), Violation> {
        let owed = std::mem::take(&mut self.nodes[i].owed);
        if let Some(history) = &mut self.history {
            history.begin(i, Ticks(u64::from(owed)), &input);
        }
        if owed > 0 {
            self.drive_on(i, Ticks(u64::from(owed)))?;
        }
        if let NodeInput::Request(task, request) = &input {
            self.compare_fused(i, *task, request)?;
        }
        if self.orders {
            return self.step_in_order(i, input);
        }
        self.drive(i, |node, out| node.small_steps(node.now(), input, out))
    }

    fn drive(&mut self, i: usize, work: impl FnOnce(&mut Node, &mut Wires<'_>)) -> Result<(), Violation> {
        let mut effects = std::mem::take(&mut self.spare);
        let mut open = self.open(i);
        work(&mut self.nodes[i].node, &mut Wires { effects: &mut effects, open: &mut open, node: small(i) });
        // All sends are recorded before any effect is judged: the node has assigned all its numbers by now.
        effects.iter().for_each(|effect| self.sent(effect));
        let result = effects.iter().try_for_each(|effect| self.follow(i, effect));
        let result = result.and_then(|()| self.judge_step(i, &effects));
        let result = match &mut self.history {
            Some(history) => result.and(history.judge(i, &self.nodes[i], &effects)),
            None => result,
        };
        if self.keep_log {
            self.log.extend(&effects);
        }
        effects.clear();
        self.spare = effects;
        let node_state = &self.nodes[i];
        let broken = |task| invariants::check(task, &node_state.table).is_err();
        if self.is_sampled && node_state.node.parts().tasks.iter().any(broken) {
            return Err(Violation::Invariant);
        }
        result
    }

    fn follow(&mut self, i: usize, effect: &Effect) -> Result<(), Violation> {
        match effect {
            Effect::Sent(next, packet) => {
                let here = NodeId::from_index(i);
                let link = self.links.iter().position(|&(a, b, _)| (a, b) == (here, *next));
                let link = small(link.ok_or(Violation::Invariant)?);
                if self.plan.room.is_some() {
                    self.used[usize::from(link)] += 1;
                }
                let incarnation = self.nodes[i].incarnation;
                self.in_flight.push(InFlight { packet: *packet, link, age: Ticks::ZERO, incarnation });
                Ok(())
            }
            Effect::Signalled(task, signal) => self.told(task.index(), signal),
            Effect::Seen(_, at, observation) => self.seen(*at, observation),
        }
    }
}

pub(crate) fn small(i: usize) -> u8 {
    u8::try_from(i).unwrap_or(u8::MAX)
}
