//! The running cell: a floor whose scripts are judged and not stopped, and the faults that are named in the cell.

use super::plan::{CellFaults, CellPlan, Conduct, Holds};
use crate::floor::Floor;
use crate::floor::canon::number;
use crate::floor::plan::{Errand, Faults, FloorPlan, TaskPlan, Way};
use crate::floor::script::Running;
use crate::state::{Packed, Violation};
use imrs_protocol::script::{Activity, ScriptInput, eval};
use imrs_protocol::{NodeInput, TaskId, Ticks};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// One thing that can happen next in a cell. Packets and links are positions in the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CellMove {
    /// Time passes until something happens.
    Pass,
    /// Time passes; this node counts one tick more or less.
    Drift(u8, bool),
    /// A packet arrives.
    Deliver(u8),
    /// It is lost.
    Lose(u8),
    /// It arrives, and will once more.
    Duplicate(u8),
    /// Its link is cut from here on: declared cut number so.
    Cut(u8, u8),
    /// Its link is still cut.
    Vanish(u8),
    /// Its link is no longer cut, and the packet arrives.
    Mend(u8, u8),
    /// An action ends: task, thread, whether well, and which of its values.
    Acted(u8, u8, bool, u8),
    /// An action does not end yet.
    GoOn(u8, u8),
    /// A script gets its choice.
    Choose(u8, u16),
    /// Declared crash number so happens.
    Crash(u8),
    /// A node starts again.
    Restart(u8),
}

/// What a declared cut of a link is at.
const UNUSED: u8 = 0;
const OPEN: u8 = 1;
const OVER: u8 = 2;

/// What the cell's state has beside the floor's.
#[derive(Clone, Debug, Default)]
struct Beside {
    loss: u8,
    dup: u8,
    fail: u8,
    drift: u8,
    /// For each declared crash, whether it happened.
    crashed: Vec<u8>,
    cuts: Vec<u8>,
    /// For each check that has to lead somewhere, the ticks left, once it must.
    due: Vec<Option<u32>>,
    /// Actions that do not end in this tick: task and thread.
    stays: Vec<(u8, u8)>,
    /// The nodes that did something in this tick, bit by bit: those that may crash now. A crash between two steps of a
    /// node and one right after the first of them are the same to everybody.
    acted: u64,
}

/// The unpacked state of a cell.
#[derive(Clone, Debug)]
pub(super) struct Course {
    pub plan: Arc<CellPlan>,
    pub faults: CellFaults,
    pub floor: Floor,
    beside: Beside,
    /// The check that was broken by the last move.
    pub broken: Option<usize>,
    /// Ticks that passed since this was last set to zero.
    pub passed: u64,
    /// For each check, whether what makes it matter was ever seen.
    pub mattered: Vec<bool>,
    /// Whether both tasks of a couple act.
    pub both_active: bool,
}

impl Course {
    pub fn new(plan: &Arc<CellPlan>, faults: &CellFaults) -> Self {
        let tasks = plan.tasks.iter().map(|task| match task {
            Conduct::Program { program, .. } => TaskPlan::scripted(Arc::clone(program)),
            Conduct::Extern(_) => TaskPlan::new(Errand::Rest),
        });
        let mut floor = FloorPlan::new(Arc::clone(&plan.table), tasks.collect());
        floor.way = Way::Exact;
        floor.transit = plan.transit;
        floor.faults = Faults { crash: u8::from(!faults.crash.is_empty()), ..Faults::default() };
        floor.checks = plan
            .checks
            .iter()
            .flat_map(|check| match &check.holds {
                Holds::Always(terms) => vec![terms.clone()],
                Holds::Leads { when, then, .. } => vec![when.clone(), then.clone()],
            })
            .collect();
        let floor = Floor::of_cell(&Arc::new(floor));
        let beside = Beside {
            loss: faults.loss,
            dup: faults.dup,
            fail: faults.fail,
            drift: faults.drift,
            crashed: vec![0; faults.crash.len()],
            cuts: vec![UNUSED; faults.cut.len()],
            due: vec![None; plan.checks.len()],
            stays: Vec::new(),
            acted: u64::MAX,
        };
        let mut course = Self {
            plan: Arc::clone(plan),
            faults: faults.clone(),
            floor,
            beside,
            broken: None,
            passed: 0,
            mattered: vec![false; plan.checks.len()],
            both_active: false,
        };
        course.floor.crossings.sort_by_key(|crossing| crossing.link);
        course.look();
        course
    }

    /// Writes the canonical state, or says what outgrew it.
    pub fn store(&mut self) -> Result<Box<[u8]>, Violation> {
        let floor = self.floor.store();
        if let Some(violation) = floor.violation() {
            return Err(violation);
        }
        let mut out = Vec::with_capacity(floor.len() + 16);
        let (b, f) = (&self.beside, &self.faults);
        for (had, left) in [(f.loss, b.loss), (f.dup, b.dup), (f.fail, b.fail), (f.drift, b.drift)] {
            if had > 0 {
                out.push(left);
            }
        }
        out.extend(&b.crashed);
        out.extend(&b.cuts);
        // Where it may not crash any more, nobody asks.
        let may = f.crash.iter().zip(&b.crashed).filter(|(_, crashed)| **crashed == 0);
        let may = may.fold(0_u64, |mask, (node, _)| mask | bit(node.index()));
        if !f.crash.is_empty() {
            out.extend((b.acted & may).to_le_bytes());
        }
        for (check, due) in self.plan.checks.iter().zip(&b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                number(due.map_or(0, |left| left + 1), &mut out);
            }
        }
        if self.plan.between {
            out.push(u8::try_from(b.stays.len()).map_err(|_| Violation::Overflow)?);
            b.stays.iter().for_each(|&(task, level)| out.extend([task, level]));
        }
        out.extend_from_slice(&floor.0);
        Ok(out.into_boxed_slice())
    }

    pub fn load(&mut self, state: &[u8]) {
        let mut at = 0;
        let mut byte = || {
            at += 1;
            state.get(at - 1).copied().unwrap_or(0)
        };
        let (b, f) = (&mut self.beside, &self.faults);
        for (had, left) in
            [(f.loss, &mut b.loss), (f.dup, &mut b.dup), (f.fail, &mut b.fail), (f.drift, &mut b.drift)]
        {
            *left = if had > 0 { byte() } else { 0 };
        }
        b.crashed.iter_mut().for_each(|crashed| *crashed = byte());
        b.cuts.iter_mut().for_each(|cut| *cut = byte());
        if !f.crash.is_empty() {
            b.acted = u64::from_le_bytes(std::array::from_fn(|_| byte()));
        }
        for (check, due) in self.plan.checks.iter().zip(&mut b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                let left = match byte() {
                    u8::MAX => u32::from_le_bytes([byte(), byte(), byte(), byte()]),
                    left => u32::from(left),
                };
                *due = left.checked_sub(1);
            }
        }
        b.stays.clear();
        if self.plan.between {
            for _ in 0..byte() {
                b.stays.push((byte(), byte()));
            }
        }
        self.floor.violation = None;
        self.floor.load_bytes(state.get(at..).unwrap_or(&[]));
    }

    /// The floor after a move that nothing is wrong with.
    pub fn after(&mut self, state: &[u8], step: CellMove) -> Option<Packed> {
        self.load(state);
        self.apply(step);
        self.floor.turns.iter_mut().for_each(Vec::clear);
        let sound = self.broken.is_none() && !self.both_active && self.floor.violation.is_none();
        sound.then(|| self.floor.store())
    }

    /// The floor without one of its packets.
    pub fn without(&mut self, state: &[u8], packet: u8) -> Packed {
        self.load(state);
        self.floor.crossings.remove(usize::from(packet));
        self.floor.store()
    }

    /// What may happen next: the first node with something to do in this tick does it; when none has, time passes.
    pub fn moves(&self, moves: &mut Vec<CellMove>) {
        for node in 0..self.floor.stations.len() {
            self.turn(node, moves);
            if !moves.is_empty() {
                return;
            }
        }
        for (at, (&node, &crashed)) in self.faults.crash.iter().zip(&self.beside.crashed).enumerate() {
            let earlier = self.faults.crash[..at].iter().zip(&self.beside.crashed);
            let first = !earlier.into_iter().any(|(&other, &done)| other == node && done == 0);
            let acted = self.beside.acted & bit(node.index()) != 0;
            if crashed == 0 && first && acted && self.floor.stations[node.index()].up {
                moves.push(CellMove::Crash(small(at)));
            }
        }
        let down = |&i: &usize| !self.floor.stations[i].up;
        moves.extend((0..self.floor.stations.len()).filter(down).map(|i| CellMove::Restart(small(i))));
        if self.next_event().is_none() {
            return;
        }
        moves.push(CellMove::Pass);
        if self.beside.drift > 0 {
            let up = (0..self.floor.stations.len()).filter(|&i| self.floor.stations[i].up);
            moves.extend(up.flat_map(|i| [true, false].map(|more| CellMove::Drift(small(i), more))));
        }
    }

    /// What may happen at a node in this tick.
    fn turn(&self, node: usize, moves: &mut Vec<CellMove>) {
        let floor = &self.floor;
        let here = |&task: &usize| floor.station_of(task) == node;
        let up = floor.stations[node].up;
        let tasks = || (0..floor.bodies.len()).filter(here).filter(|_| up);
        for task in tasks() {
            let chooses = floor.bodies[task].actor.as_ref().and_then(|actor| actor.chooses());
            if let Some(alternatives) = chooses {
                moves.extend((0..alternatives).map(|choice| CellMove::Choose(small(task), choice)));
                return;
            }
        }
        for task in tasks() {
            let Some(actor) = &floor.bodies[task].actor else { continue };
            for action in &actor.running {
                self.ends(task, action, moves);
            }
        }
        for (i, crossing) in floor.crossings.iter().enumerate() {
            let (_, to, bound) = floor.links[usize::from(crossing.link)];
            let behind = floor.crossings[..i].iter().any(|other| other.link == crossing.link);
            if to.index() == node && crossing.age >= bound && !behind {
                self.arrivals(small(i), crossing.link, moves);
            }
        }
    }

    fn ends(&self, task: usize, action: &Running, moves: &mut Vec<CellMove>) {
        if action.least > 0 || self.beside.stays.contains(&(small(task), action.level)) {
            return;
        }
        let (task, level) = (small(task), action.level);
        let values = self.values(usize::from(task), action.action).len().max(1);
        moves.extend((0..values).map(|value| CellMove::Acted(task, level, true, small(value))));
        if self.beside.fail > 0 {
            moves.push(CellMove::Acted(task, level, false, 0));
        }
        if action.most > 0 {
            moves.push(CellMove::GoOn(task, level));
        }
    }

    fn values(&self, task: usize, action: u16) -> &[i32] {
        match &self.plan.tasks[task] {
            Conduct::Program { values, .. } => values.get(usize::from(action)).map_or(&[], Vec::as_slice),
            Conduct::Extern(_) => &[],
        }
    }

    /// The result that this end of an action gives.
    pub fn value(&self, task: usize, level: u8, value: u8) -> i32 {
        let actor = self.floor.bodies[task].actor.as_ref();
        let running = actor.and_then(|actor| actor.running.iter().find(|action| action.level == level));
        let values = running.map_or(&[][..], |action| self.values(task, action.action));
        values.get(usize::from(value)).copied().unwrap_or(0)
    }

    fn arrivals(&self, i: u8, link: u8, moves: &mut Vec<CellMove>) {
        let cuts = self.faults.cut.iter().zip(&self.beside.cuts).enumerate();
        let of_link = |at: usize| at == usize::from(link) / 2;
        let mut first = true;
        for (number, (&at, &state)) in cuts {
            if of_link(at) && state == OPEN {
                moves.extend([CellMove::Vanish(i), CellMove::Mend(i, small(number))]);
                return;
            }
        }
        moves.push(CellMove::Deliver(i));
        if self.beside.loss > 0 {
            moves.push(CellMove::Lose(i));
        }
        if self.beside.dup > 0 {
            moves.push(CellMove::Duplicate(i));
        }
        for (number, (&at, &state)) in self.faults.cut.iter().zip(&self.beside.cuts).enumerate() {
            if of_link(at) && state == UNUSED && first {
                moves.push(CellMove::Cut(i, small(number)));
                first = false;
            }
        }
    }

    /// In how many ticks the next thing happens.
    fn next_event(&self) -> Option<u32> {
        let floor = &self.floor;
        let packets = floor.crossings.iter().map(|crossing| {
            u64::from(floor.links[usize::from(crossing.link)].2.saturating_sub(crossing.age))
        });
        let nodes = floor.stations.iter().filter(|s| s.up).filter_map(|s| s.node.next_expiry()).map(|t| t.0);
        let actions = floor.bodies.iter().filter_map(|body| body.actor.as_ref()).flat_map(|a| &a.running);
        let ends = actions.filter(|action| action.most != Running::FOREVER || action.least > 0);
        let ends = ends.map(|action| u64::from(if action.least > 0 { action.least } else { action.most }));
        // What is due is looked at when its last tick is over.
        let due = self.beside.due.iter().flatten().map(|&left| u64::from(left) + 1);
        let next = packets.chain(nodes).chain(ends).chain(due).min()?;
        u32::try_from(next.max(1)).ok()
    }

    /// Carries a move out and looks at what came of it.
    pub fn apply(&mut self, step: CellMove) {
        self.broken = None;
        self.beside.acted |= self.node_of(step).map_or(0, bit);
        let result = self.carry_out(step).and_then(|()| self.floor.run_scripts());
        if let Err(violation) = result {
            self.floor.violation = Some(violation);
        }
        // As the packed state has them: positions mean the same in a state that was never packed.
        self.floor.crossings.sort_by_key(|crossing| crossing.link);
        self.look();
    }

    /// The node at which a move happens.
    fn node_of(&self, step: CellMove) -> Option<usize> {
        match step {
            CellMove::Deliver(i) | CellMove::Duplicate(i) | CellMove::Mend(i, _) => {
                let link = self.floor.crossings.get(usize::from(i))?.link;
                Some(self.floor.links[usize::from(link)].1.index())
            }
            CellMove::Acted(task, ..) | CellMove::Choose(task, _) => {
                Some(self.floor.station_of(usize::from(task)))
            }
            CellMove::Restart(node) => Some(usize::from(node)),
            CellMove::Pass
            | CellMove::Drift(..)
            | CellMove::Lose(_)
            | CellMove::Cut(..)
            | CellMove::Vanish(_)
            | CellMove::GoOn(..)
            | CellMove::Crash(_) => None,
        }
    }

    fn carry_out(&mut self, step: CellMove) -> Result<(), Violation> {
        let floor = &mut self.floor;
        match step {
            CellMove::Pass => self.pass(None),
            CellMove::Drift(node, more) => {
                self.beside.drift -= 1;
                self.pass(Some((usize::from(node), more)))
            }
            CellMove::Deliver(i) => {
                let crossing = floor.crossings.remove(usize::from(i));
                floor.deliver(crossing, 0)
            }
            CellMove::Lose(i) => {
                self.beside.loss -= 1;
                floor.crossings.remove(usize::from(i));
                Ok(())
            }
            CellMove::Duplicate(i) => {
                self.beside.dup -= 1;
                let crossing = floor.crossings[usize::from(i)];
                floor.deliver(crossing, 0)
            }
            CellMove::Cut(i, number) => {
                self.beside.cuts[usize::from(number)] = OPEN;
                floor.crossings.remove(usize::from(i));
                Ok(())
            }
            CellMove::Vanish(i) => {
                floor.crossings.remove(usize::from(i));
                Ok(())
            }
            CellMove::Mend(i, number) => {
                self.beside.cuts[usize::from(number)] = OVER;
                let crossing = floor.crossings.remove(usize::from(i));
                floor.deliver(crossing, 0)
            }
            CellMove::Acted(task, level, ok, value) => {
                self.beside.fail -= u8::from(!ok);
                let value = if ok { self.value(usize::from(task), level, value) } else { 0 };
                self.floor.acted(usize::from(task), level, ok, value);
                Ok(())
            }
            CellMove::GoOn(task, level) => {
                self.go_on(usize::from(task), level);
                Ok(())
            }
            CellMove::Choose(task, choice) => {
                floor.leave(usize::from(task), ScriptInput::Chosen(choice));
                Ok(())
            }
            CellMove::Crash(number) => {
                self.beside.crashed[usize::from(number)] = 1;
                let node = self.faults.crash[usize::from(number)].index();
                floor.note_crash(node);
                floor.crash(node);
                Ok(())
            }
            CellMove::Restart(node) => {
                floor.note_restart(usize::from(node));
                floor.restart_behind(usize::from(node))
            }
        }
    }

    fn go_on(&mut self, task: usize, level: u8) {
        if self.plan.between {
            self.beside.stays.push((small(task), level));
            self.beside.stays.sort_unstable();
            return;
        }
        let Some(actor) = &mut self.floor.bodies[task].actor else { return };
        let actions = actor.running.iter_mut().filter(|action| action.level == level);
        actions.for_each(|action| action.least = action.most);
    }

    fn pass(&mut self, drift: Option<(usize, bool)>) -> Result<(), Violation> {
        let Some(ticks) = self.next_event() else { return Ok(()) };
        self.passed += u64::from(ticks);
        self.beside.stays.clear();
        self.beside.acted = 0;
        for (check, due) in self.beside.due.iter_mut().enumerate() {
            match due.map(|left| left.checked_sub(ticks)) {
                Some(Some(left)) => *due = Some(left),
                Some(None) => {
                    *due = None;
                    self.broken = Some(check);
                }
                None => {}
            }
        }
        let floor = &mut self.floor;
        let age = u8::try_from(ticks).unwrap_or(u8::MAX);
        floor.crossings.iter_mut().for_each(|crossing| crossing.age = crossing.age.saturating_add(age));
        let stations = 0..floor.stations.len();
        for task in 0..floor.bodies.len() {
            let up = floor.stations[floor.station_of(task)].up;
            if let (true, Some(actor)) = (up, &mut floor.bodies[task].actor) {
                actor.pass(ticks);
            }
        }
        for node in stations.filter(|&i| self.floor.stations[i].up).collect::<Vec<_>>() {
            let ticks = match drift {
                Some((at, true)) if at == node => ticks + 1,
                Some((at, false)) if at == node => ticks - 1,
                Some(_) | None => ticks,
            };
            let due = self.floor.stations[node].node.next_expiry();
            if due.is_some_and(|due| due.0 <= u64::from(ticks)) {
                self.beside.acted |= bit(node);
            }
            if ticks > 0 {
                self.floor.step(node, NodeInput::Advance(Ticks(u64::from(ticks))))?;
            }
            self.floor.run_scripts()?;
        }
        Ok(())
    }

    /// Looks at the checks and at who acts.
    fn look(&mut self) {
        let is = |floor: &Floor, terms: &[_]| {
            eval(terms, |term| floor.look_up(term)).is_ok_and(|value| value != 0)
        };
        for (at, check) in self.plan.checks.iter().enumerate() {
            match &check.holds {
                Holds::Always(terms) => {
                    if !is(&self.floor, terms) {
                        self.broken = Some(at);
                    }
                }
                Holds::Leads { when, then, within } => {
                    let due = &mut self.beside.due[at];
                    let when = is(&self.floor, when);
                    self.mattered[at] |= when;
                    if is(&self.floor, then) {
                        *due = None;
                    } else if when && due.is_none() && self.broken != Some(at) {
                        *due = Some(u32::try_from(within.0).unwrap_or(u32::MAX - 1));
                    }
                }
            }
        }
        let acts = |task: TaskId| {
            let station = &self.floor.stations[self.floor.station_of(task.index())];
            station.up && station.node.task(task).is_some_and(imrs_protocol::CommTask::is_active)
        };
        let couples = &self.plan.table.cell().couples;
        self.both_active = couples.iter().any(|couple| acts(couple.primary) && acts(couple.standby));
    }

    /// What a task does.
    pub fn activity(&self, task: usize) -> Option<Activity> {
        Some(self.floor.bodies[task].actor.as_ref()?.script.activity())
    }

    pub fn is_up(&self, task: usize) -> bool {
        self.floor.stations[self.floor.station_of(task)].up
    }

    pub fn crash_node(&self, number: u8) -> usize {
        self.faults.crash[usize::from(number)].index()
    }
}

/// The bit of a node; those past the last one share it.
fn bit(node: usize) -> u64 {
    1 << node.min(63)
}

pub(super) fn small(i: usize) -> u8 {
    u8::try_from(i).unwrap_or(u8::MAX)
}
