//! The unpacked state of a cell during a search: the nodes and packets in flight, the remaining faults, and the checks.

mod between;
pub(super) mod canon;
mod checks;
mod elapse;
mod held;
mod liveness;
mod moves;
mod order;
mod pause;
mod progress;
mod step;

pub use step::CellMove;

use super::plan::{CellFaults, CellPlan, Conduct, Holds, Times};
use crate::cell_state::CellState;
use crate::cell_state::plan::{CellScenario, Errand, Faults, TaskPlan, Transfer};
use crate::state::Violation;
use checks::Evaluated;
use imrs_protocol::script::{Activity, ScriptInput};
use imrs_protocol::{TaskId, Ticks};
use liveness::Dead;
use order::{Mixture, Spread, TickValues};
use pause::Asleep;
use progress::Before;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// The states of a declared cut of a link. A larger number covers a smaller one: a cut that is over allows no faults, an
/// open cut may end before the next packet, and an unused cut may begin with the next packet.
pub(super) const UNUSED: u8 = 2;
pub(super) const OPEN: u8 = 1;
const OVER: u8 = 0;

/// The fields of a cell state beside its [`CellState`]: remaining fault budgets, postponed events, restarts, obligations of checks.
#[derive(Clone, Debug, Default)]
pub(super) struct Beside {
    pub loss: u8,
    pub dup: u8,
    pub reorder: u8,
    pub fail: u8,
    pub drift: u8,
    /// For each declared crash, 1 once the crash has happened.
    pub crashed: Vec<u8>,
    pub cuts: Vec<u8>,
    /// For each declared pause, 1 until the pause begins.
    pub paused: Vec<u8>,
    /// For each node, its pause, if the node is paused now.
    pub asleep: Vec<Option<Asleep>>,
    /// For each `leads` check with an open obligation, the time that is left to fulfil the obligation.
    pub due: Vec<Option<Ticks>>,
    /// Actions whose end is postponed until another event, or until their most time is over: task and activation.
    pub stays: Vec<(u8, u8)>,
    /// Links, as a bit set, whose first packet is postponed until another event, or until the link's bound is over.
    pub slow: u64,
    /// For each node, the time until the last of its scripts begins, which a restart holds back (D94).
    pub held_back: Vec<Option<Ticks>>,
    /// For each node, the tasks whose scripts begin in this tick, as a bit set.
    pub begins: Vec<u64>,
    /// Nodes that took a step or crashed in this tick, as a bit set. Only these may crash, or restart at once. No task can tell
    /// a crash before a node's next step from one right after its last step.
    pub acted: u64,
}

/// The unpacked state of a cell: its [`CellState`] (nodes and packets in flight), the remaining faults, what the last move broke.
#[derive(Clone, Debug)]
pub(super) struct RunState {
    pub plan: Arc<CellPlan>,
    pub faults: CellFaults,
    pub cell: CellState,
    pub beside: Beside,
    /// When actions may end and packets may arrive.
    pub times: Times,
    /// The checks that the last move broke.
    pub broken: Vec<usize>,
    /// Ticks since the start of the path, or since the caller set this field to zero.
    pub passed: u64,
    /// For each check, whether its left side was ever true.
    pub mattered: Vec<bool>,
    checks: Evaluated,
    /// The checks that read several nodes.
    pub spread: Vec<Spread>,
    pub tick_values: Vec<TickValues>,
    /// Checks that are broken by a combination of the values that their nodes showed in one tick, although no
    /// single state breaks them.
    pub mixed: Vec<(usize, Mixture)>,
    /// Whether both tasks of some couple act.
    pub both_active: bool,
    /// For each task, its dead variables at each operation.
    dead: Vec<Dead>,
    /// Scratch buffer for the variables of each task before a move, and for which of them are dead.
    before: Before,
    /// The bytes of the last packed state. The buffer is kept, so that the next state is packed without allocating.
    packed: Vec<u8>,
}

impl RunState {
    pub fn new(plan: &Arc<CellPlan>, faults: &CellFaults) -> Self {
        Self::begun(plan, faults, false)
    }

    /// The first state of a run that is never packed. Rules over the history of the run are judged in it, too.
    pub fn with_history(plan: &Arc<CellPlan>, faults: &CellFaults) -> Self {
        Self::begun(plan, faults, true)
    }

    fn begun(plan: &Arc<CellPlan>, faults: &CellFaults, history: bool) -> Self {
        let tasks = plan.tasks.iter().map(|task| match task {
            Conduct::Program { program, .. } => TaskPlan::scripted(Arc::clone(program)),
            Conduct::Extern(_) => TaskPlan::new(Errand::Rest),
        });
        let mut cell_state = CellScenario::new(Arc::clone(&plan.table), tasks.collect());
        cell_state.transfer = Transfer::Exact;
        cell_state.keeps_seen = plan.everything;
        cell_state.history = history;
        cell_state.transit = plan.transit;
        cell_state.left_out = plan.part.as_ref().map_or(0, |part| part.left_out());
        cell_state.faults = Faults { crash: u8::from(!faults.crash.is_empty()), ..Faults::default() };
        cell_state.checks = plan
            .checks
            .iter()
            .flat_map(|check| match &check.holds {
                Holds::Always(terms) => vec![terms.clone()],
                Holds::Leads { when, then, .. } => vec![when.clone(), then.clone()],
            })
            .collect();
        let cell_state = CellState::of_cell(&Arc::new(cell_state));
        let beside = Beside {
            loss: faults.loss,
            dup: faults.dup,
            reorder: faults.reorder,
            fail: faults.fail,
            drift: faults.drift,
            crashed: vec![0; faults.crash.len()],
            cuts: vec![UNUSED; faults.cut.len()],
            paused: vec![1; faults.pause.len()],
            asleep: vec![None; plan.table.cell().nodes.len()],
            due: vec![None; plan.checks.len()],
            stays: Vec::new(),
            slow: 0,
            held_back: vec![None; plan.table.cell().nodes.len()],
            begins: vec![0; plan.table.cell().nodes.len()],
            acted: u64::MAX,
        };
        let mut run_state = Self {
            plan: Arc::clone(plan),
            faults: faults.clone(),
            cell: cell_state,
            beside,
            times: plan.times.max(Times::Ends).min(Times::Every),
            broken: Vec::new(),
            passed: 0,
            mattered: vec![false; plan.checks.len()],
            checks: Evaluated::new(plan),
            spread: Self::spread(plan),
            tick_values: Vec::new(),
            mixed: Vec::new(),
            both_active: false,
            dead: if plan.everything { Vec::new() } else { liveness::dead(plan) },
            before: Before::default(),
            packed: Vec::new(),
        };
        run_state.cell.in_flight.sort_by_key(|carried| carried.link);
        run_state.tick_values = Self::first_tick_values(&run_state.cell, &run_state.spread);
        run_state.look();
        run_state
    }

    /// The dead variables of a task at its present operation, as a bit set.
    pub fn dead_variables(&self, task: usize) -> u64 {
        let actor = self.cell.bodies[task].actor.as_ref();
        self.dead.get(task).zip(actor).map_or(0, |(dead, actor)| dead.at(actor.host.script.position_at(0)))
    }

    /// Resets the dead variables, so that states that differ only in these variables become equal.
    pub fn bury(&mut self) {
        for task in 0..self.cell.bodies.len() {
            let mut left = self.dead_variables(task);
            let Some(actor) = &mut self.cell.bodies[task].actor else { continue };
            while left != 0 {
                actor.host.script.bury_variable(u16::try_from(left.trailing_zeros()).unwrap_or(0));
                left &= left - 1;
            }
        }
    }

    /// Makes a move, lets the scripts run, and evaluates the checks.
    pub fn apply(&mut self, step: CellMove) {
        self.broken.clear();
        if let Some(node) = self.node_of(step) {
            self.beside.acted |= bit(node);
            // `stir` (which ends postponements) does not run for these moves. It has already run in the move that queued
            // the input, or when the passing of time made the script due.
            if !matches!(step, CellMove::Take(..) | CellMove::Begin(_)) {
                self.stir();
            }
        }
        let result = self.carry_out(step).and_then(|()| self.cell.run_scripts());
        if let Err(violation) = result {
            self.cell.violation = Some(violation);
        }
        // Packing sorts the packets, too: so packet positions are the same in a state that was never packed.
        self.cell.in_flight.sort_by_key(|carried| carried.link);
        self.cell.sort_inputs();
        self.settle();
        self.checks.note(&self.plan, step, self.cell.turns.as_deref().unwrap_or_default());
        self.look();
    }

    /// Makes a move. Returns false if the move panics.
    pub fn survives(&mut self, step: CellMove) -> bool {
        catch_unwind(AssertUnwindSafe(|| self.apply(step))).is_ok()
    }

    /// The node that takes a step in a move, if one does.
    fn node_of(&self, step: CellMove) -> Option<usize> {
        match step {
            CellMove::Deliver(i) | CellMove::Duplicate(i) | CellMove::Mend(i, _) => {
                let link = self.cell.in_flight.get(usize::from(i))?.link;
                Some(self.cell.links[usize::from(link)].1.index())
            }
            CellMove::Acted(task, ..) | CellMove::Choose(task, _) => {
                Some(self.cell.node_state_of(usize::from(task)))
            }
            CellMove::Restart(node)
            | CellMove::Wake(node)
            | CellMove::Begin(node)
            | CellMove::Take(node, _) => Some(usize::from(node)),
            CellMove::Pass
            | CellMove::Drift(..)
            | CellMove::Lose(_)
            | CellMove::Cut(..)
            | CellMove::Vanish(_)
            | CellMove::GoOn(..)
            | CellMove::Takes(..)
            | CellMove::Stay(_)
            | CellMove::Crash(_)
            | CellMove::Pause(..)
            | CellMove::PauseBefore(..)
            | CellMove::PauseNext(..) => None,
        }
    }

    fn carry_out(&mut self, step: CellMove) -> Result<(), Violation> {
        let cell_state = &mut self.cell;
        match step {
            CellMove::Pass => self.pass(self.next_event(), None),
            CellMove::Drift(node, more) => {
                self.beside.drift -= 1;
                self.pass(self.next_event(), Some((usize::from(node), more)))
            }
            CellMove::Pause(number, node) => {
                self.fall_asleep(number, usize::from(node), Vec::new());
                Ok(())
            }
            CellMove::PauseBefore(number, node) => {
                self.fall_asleep_before(number, usize::from(node));
                Ok(())
            }
            CellMove::PauseNext(number, node) => {
                let next = self.next_event();
                self.fall_asleep(number, usize::from(node), Vec::new());
                let result = self.pass(next, None);
                // The bound of the pause counts from the tick in which the node would have noticed something.
                let most = self.faults.pause[usize::from(number)].most;
                self.beside.asleep[usize::from(node)].iter_mut().for_each(|asleep| asleep.left = most);
                result
            }
            CellMove::Wake(node) => self.wake(usize::from(node)),
            CellMove::Deliver(i) => {
                self.beside.reorder -= u8::from(cell_state.is_behind(usize::from(i)));
                let carried = cell_state.in_flight.remove(usize::from(i));
                cell_state.deliver(carried, 0)
            }
            CellMove::Lose(i) | CellMove::Vanish(i) => {
                self.beside.loss -= u8::from(matches!(step, CellMove::Lose(_)));
                self.take_off(i);
                Ok(())
            }
            CellMove::Duplicate(i) => {
                self.beside.dup -= 1;
                let carried = cell_state.in_flight[usize::from(i)];
                cell_state.deliver(carried, 0)
            }
            CellMove::Cut(i, number) => {
                self.beside.cuts[usize::from(number)] = OPEN;
                self.take_off(i);
                Ok(())
            }
            CellMove::Mend(i, number) => {
                self.beside.cuts[usize::from(number)] = OVER;
                let carried = cell_state.in_flight.remove(usize::from(i));
                cell_state.deliver(carried, 0)
            }
            CellMove::Acted(task, level, ok, value) => {
                self.beside.fail -= u8::from(!ok);
                let value = if ok { self.value(usize::from(task), level, value) } else { 0 };
                self.cell.acted(usize::from(task), level, ok, value);
                Ok(())
            }
            CellMove::GoOn(task, level) => {
                self.go_on(usize::from(task), level);
                Ok(())
            }
            CellMove::Takes(task, level, ticks) => {
                let actor = self.cell.bodies[usize::from(task)].actor.as_mut();
                let running = actor.and_then(|actor| actor.running.iter_mut().find(|one| one.level == level));
                if let Some(action) = running {
                    action.least = Ticks(ticks.into()).min(action.most);
                }
                Ok(())
            }
            CellMove::Stay(link) => {
                self.beside.slow |= bit(usize::from(link));
                Ok(())
            }
            CellMove::Take(node, at) => cell_state.take(usize::from(node), usize::from(at)),
            CellMove::Begin(node) => self.begin_next(usize::from(node)),
            CellMove::Choose(task, choice) => {
                cell_state.leave(usize::from(task), ScriptInput::Chosen(choice));
                Ok(())
            }
            CellMove::Crash(number) => {
                self.beside.crashed[usize::from(number)] = 1;
                let node = self.faults.crash[usize::from(number)].index();
                cell_state.note_crash(node);
                cell_state.crash(node);
                self.forget_pause(node);
                self.beside.held_back[node] = None;
                self.beside.begins[node] = 0;
                // The node may restart in this tick.
                self.beside.acted |= bit(node);
                Ok(())
            }
            CellMove::Restart(node) => {
                let at = usize::from(node);
                cell_state.note_restart(at);
                cell_state.restart_behind(at)?;
                self.begin_again(at);
                Ok(())
            }
        }
    }

    /// Removes a packet from its link without delivering it.
    fn take_off(&mut self, packet: u8) {
        let link = self.cell.in_flight.remove(usize::from(packet)).link;
        self.beside.slow &= !bit(usize::from(link));
    }

    /// Whether a task of a couple is active: it holds its lease or has taken over (D61).
    pub fn acts(&self, task: TaskId) -> bool {
        self.cell.is_active(task)
    }

    /// What a task's script is doing; `None` if the task has no script.
    pub fn activity(&self, task: usize) -> Option<Activity> {
        Some(self.cell.bodies[task].actor.as_ref()?.host.script.activity())
    }

    pub fn is_up(&self, task: usize) -> bool {
        self.cell.nodes[self.cell.node_state_of(task)].up
    }

    /// Whether a node is down and may restart. Nodes outside the searched part never do.
    pub fn is_down(&self, node: usize) -> bool {
        !self.cell.nodes[node].up && self.plan.has_node(node)
    }

    pub fn crash_node(&self, number: u8) -> usize {
        self.faults.crash[usize::from(number)].index()
    }
}

/// The bit of a node or link in a bit set. Nodes and links past 63 share the last bit.
pub(super) fn bit(node: usize) -> u64 {
    1 << node.min(63)
}

pub(super) fn small(i: usize) -> u8 {
    u8::try_from(i).unwrap_or(u8::MAX)
}
