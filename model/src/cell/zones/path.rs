//! Makes the path to a finding again on symbolic times.
//!
//! The path is a list of moves on plain ticks. On symbolic times the instant at which something happens is a variable, and each
//! comparison has the answer that the plain path gave. The zone of this run has all times at which the same moves are possible at
//! these instants. To put off the end of an action or the arrival of a packet is no such move.

use super::fixed::{Number, Numbers, Timing};
use super::runner::CHOICE;
use super::search::Search;
use crate::cell::judge::{Shown, judge, nothing_reached};
use crate::cell::plan::{CellFaults, CellPlan};
use crate::cell::run_state::{CellMove, RunState};
use crate::cell::verdict::{Kind, Phase, TimeRange, Timed};
use crate::cell::waiting::for_ever;
use crate::cell_state::script::Running;
use crate::zone::dbm::Dbm;
use crate::zone::forks::guided::Guide;
use crate::zone::forks::{Forks, again, each};
use crate::zone::times::symbol_of;
use imrs_protocol::symbolic::{self, START, Symbol};
use imrs_protocol::{TaskId, Ticks};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The greatest number of instants of a path. A symbolic time can name 255 variables, and some times need one of their own.
const INSTANTS: usize = 200;

/// An instant at which something happens, and the moves of this instant.
pub(super) struct Instant {
    pub tick: u64,
    pub moves: Vec<CellMove>,
}

/// A variable and an offset: an instant.
type Term = (u8, i64);

/// Makes the moves on plain ticks, and returns the instants at which something happens; `None` if a move is none of a search by zones.
pub(super) fn instants(
    plan: &Arc<CellPlan>,
    faults: &CellFaults,
    moves: &[CellMove],
) -> Option<Vec<Instant>> {
    let mut run_state = RunState::new(plan, faults);
    let mut instants = vec![Instant { tick: 0, moves: Vec::new() }];
    for (at, &step) in moves.iter().enumerate() {
        if !run_state.survives(step) {
            return None;
        }
        let tick = run_state.passed;
        let is_new = instants.last().is_some_and(|last| last.tick != tick);
        let happens = match step {
            CellMove::Pass => {
                run_state.beside.acted != 0 || !run_state.broken.is_empty() || at + 1 == moves.len()
            }
            CellMove::GoOn(..) | CellMove::Stay(_) => false,
            CellMove::Takes(..) | CellMove::Drift(..) | CellMove::Wake(_) => return None,
            CellMove::Pause(..) | CellMove::PauseBefore(..) | CellMove::PauseNext(..) => return None,
            _ => true,
        };
        if happens && is_new {
            instants.push(Instant { tick, moves: Vec::new() });
        }
        if happens && step != CellMove::Pass {
            instants.last_mut()?.moves.push(step);
        }
    }
    (instants.len() <= INSTANTS).then_some(instants)
}

/// The part of a zone in which a time is as short or (`true`) as long as it may be; `None` if it has no such bound.
fn at_end(zone: &Dbm, took: Symbol, is_long: bool) -> Option<Dbm> {
    let (first, second) = (usize::from(took.first), usize::from(took.second));
    let (one, other) = if is_long { (first, second) } else { (second, first) };
    let (mut end, bound) = (zone.clone(), zone.bound(one, other)?);
    end.constrain(other, one, -bound).ok().map(|()| end)
}

fn instant((variable, offset): Term) -> imrs_protocol::Instant {
    symbolic::instant(variable) + Ticks(offset.unsigned_abs())
}

/// An action that has begun.
struct Begun {
    at: Term,
    action: u16,
    least: Ticks,
    most: Ticks,
}

/// An action or a packet that has ended.
struct Ended {
    number: Number,
    /// The move that ended it.
    step: CellMove,
    timed: Timed,
    took: Symbol,
    /// The least and the greatest time that the cell declares.
    declared: [Ticks; 2],
}

/// A path that is made again on symbolic times.
pub(super) struct Path<'a> {
    guide: &'a Guide,
    cell: RunState,
    /// The present instant.
    now: Term,
    /// For each instant but the first, the variable that is one tick before it.
    pub untils: Vec<u8>,
    /// The running actions, by task and activation.
    running: BTreeMap<(u8, u8), Begun>,
    numbers: Numbers,
    ended: Vec<Ended>,
}

impl<'a> Path<'a> {
    pub fn new(guide: &'a Guide, plan: &Arc<CellPlan>, faults: &CellFaults) -> Self {
        // Nothing is packed in this run, and so no invariants of packed states are checked.
        let (mut cell, _) = again(&Dbm::zero(), &[], |_| RunState::new(plan, faults));
        (cell.cell.is_symbolic, cell.cell.is_sampled) = (true, false);
        Self {
            guide,
            cell,
            now: (START, 0),
            untils: Vec::new(),
            running: BTreeMap::new(),
            numbers: Numbers::default(),
            ended: Vec::new(),
        }
    }

    /// Makes the moves; `None` if one is not possible, if the last one does not show the finding, or if the zone of the run is not exact.
    pub fn run(&mut self, phase: Phase, instants: &[Instant], shown: &Shown) -> Option<()> {
        let mut reached = nothing_reached(&self.cell);
        let mut last = judge(&mut self.cell, phase, &mut reached);
        self.note_begun();
        for instant in instants {
            let pass = (instant.tick > 0).then_some(CellMove::Pass);
            for step in pass.into_iter().chain(instant.moves.iter().copied()) {
                if step == CellMove::Pass {
                    self.wait_until(instant.tick)?;
                } else {
                    self.is_possible(step)?;
                }
                self.numbers.end(&self.cell.cell, step);
                self.cell.apply(step);
                self.note_begun();
                last = judge(&mut self.cell, phase, &mut reached);
            }
        }
        let waits = [false, true].into_iter().filter_map(|goes_on| for_ever(&self.cell, goes_on));
        let is_shown = match shown.kind {
            Kind::Standstill => self.is_still(phase),
            _ => last.into_iter().chain(waits).any(|last| last.is_same(shown)),
        };
        (is_shown && self.guide.is_exact()).then_some(())
    }

    /// Whether no move leads to progress from the present state any more, at any of its times.
    fn is_still(&self, phase: Phase) -> bool {
        let mut parts = Vec::new();
        each(
            &self.guide.zone(),
            |forks| self.packed(forks),
            |control, cut| parts.push((control.filter(|_| cut.is_exact()), cut.state())),
        );
        let (plan, faults) = (&self.cell.plan, &self.cell.faults);
        parts.into_iter().all(|(control, zone)| {
            control.is_some_and(|control| Search::is_still(plan, (phase, faults), (control, zone)))
        })
    }

    /// The control of the present state without remaining faults.
    fn packed(&self, forks: &Forks) -> Option<Box<[u8]>> {
        let mut cell = self.cell.clone();
        for (task, body) in (0_u8..).zip(&mut cell.cell.bodies) {
            for action in body.actor.iter_mut().flat_map(|actor| &mut actor.running) {
                if let Some(begun) = self.running.get(&(task, action.level)) {
                    action.least = begun.least - (instant(self.now) - instant(begun.at));
                }
            }
        }
        cell.beside.use_up_faults();
        forks.cut().begin_to_pack(self.now);
        cell.pack().ok()?;
        Some([&[CHOICE], cell.packed()].concat().into())
    }

    /// Lets time pass up to one tick before an instant, at which the next event happens. Meanwhile no deadline, no bound of a packet, and no most time of an
    /// action may come.
    fn wait_until(&mut self, tick: u64) -> Option<()> {
        self.cell.end_instant();
        self.cell.next_step();
        let limits: Vec<Ticks> = self.cell.limits().collect();
        let (now, offset) = self.now;
        let until = self.guide.add(i64::try_from(tick).ok()? - 1);
        let silent = Symbol { first: until, second: now, offset: -offset };
        let mut is_possible = self.guide.keep(silent);
        for limit in limits.into_iter().filter_map(symbol_of) {
            // One tick passes even if something was due at once.
            let less = Symbol { offset: limit.offset - 1, ..limit };
            let at_most =
                if self.guide.keep(less) { less } else { Symbol { first: START, second: START, offset: 0 } };
            is_possible &= self.guide.keep_at_most(silent, at_most);
        }
        let elapsed = self.cell.elapse(symbolic::instant(until) - instant(self.now), None);
        self.now = (until, 1);
        self.untils.push(until);
        (is_possible && elapsed.is_ok() && self.cell.beside.acted == 0).then_some(())
    }

    /// Keeps the times at which a move is possible, and notes the time that ends with the move; `None` if the move is not possible at
    /// the times of the plain path.
    fn is_possible(&mut self, step: CellMove) -> Option<()> {
        let number = self.numbers.of(&self.cell.cell, step);
        if let CellMove::Acted(task, level, ..) = step {
            let begun = self.running.remove(&(task, level))?;
            let took = self.since(begun.at);
            let least = i64::try_from(begun.least.0).ok()?;
            let timed = self.action(task, &begun);
            let declared = [begun.least, begun.most];
            self.ended.push(Ended { number: number?, step, timed, took, declared });
            return self.guide.keep(Symbol { offset: took.offset - least, ..took }).then_some(());
        }
        let Some(packet) = step.packet() else { return Some(()) };
        let carried = *self.cell.cell.in_flight.get(usize::from(packet))?;
        let (from, to, bound) = self.cell.cell.links[usize::from(carried.link)];
        let bound = Ticks(bound.into());
        let comes = match step {
            // A packet overtakes the one ahead of it only when that one is about to arrive.
            CellMove::Deliver(i) if self.cell.cell.is_behind(usize::from(i)) => {
                let ahead = self.cell.cell.in_flight.iter().find(|other| other.link == carried.link);
                ahead.is_some_and(|ahead| ahead.age >= bound)
            }
            CellMove::Deliver(_) | CellMove::Mend(..) => true,
            // A packet is lost, cut off or copied when its bound is over.
            _ => carried.age >= bound,
        };
        let timed = Timed::Packet { port: carried.packet.port, from, to };
        let (took, declared) = (symbol_of(carried.age)?, [Ticks(1).min(bound), bound]);
        self.ended.push(Ended { number: number?, step, timed, took, declared });
        comes.then_some(())
    }

    /// How long everything takes that has ended, and the action or packet `end`, at a point of the zone: at the least or (`true`) the
    /// greatest time of `end`.
    pub fn timing(&self, end: Option<(Number, bool)>) -> Timing {
        let mut zone = self.guide.zone();
        let going: Vec<Ended> =
            self.not_ended().filter(|going| end.is_some_and(|(number, _)| number == going.number)).collect();
        let all = || self.ended.iter().chain(&going);
        let of = |(number, is_long): (Number, bool)| {
            let ended = all().find(|ended| ended.number == number)?;
            at_end(&zone, ended.took, is_long)
        };
        zone = end.and_then(of).unwrap_or(zone);
        let point = zone.point();
        let of = |ended: &Ended| {
            let Symbol { first, second, offset } = ended.took;
            let ticks = point[usize::from(first)] - point[usize::from(second)] + offset;
            (ended.number, (ticks.unsigned_abs(), ended.step))
        };
        all().map(of).collect()
    }

    /// The time since an instant.
    const fn since(&self, (variable, offset): Term) -> Symbol {
        Symbol { first: self.now.0, second: variable, offset: self.now.1 - offset }
    }

    fn action(&self, task: u8, begun: &Begun) -> Timed {
        let actor = self.cell.cell.bodies[usize::from(task)].actor.as_ref();
        let names = actor.map_or(&[][..], |actor| &actor.host.program.actions);
        let name = names.get(usize::from(begun.action)).cloned().unwrap_or_default();
        Timed::Action { task: TaskId::from_index(task.into()), name }
    }

    /// Notes the actions that began with the last move, and forgets those that no longer run.
    fn note_begun(&mut self) {
        self.numbers.note(&self.cell.cell, 0);
        let mut before = std::mem::take(&mut self.running);
        for (task, body) in (0_u8..).zip(&mut self.cell.cell.bodies) {
            for action in body.actor.iter_mut().flat_map(|actor| &mut actor.running) {
                let key = (task, action.level);
                let begun = before.remove(&key).unwrap_or_else(|| {
                    let begun =
                        Begun { at: self.now, action: action.action, least: action.least, most: action.most };
                    if action.most != Running::FOREVER {
                        // `is_possible` checks the least time of the action when the action ends. The state gets zero
                        // for it, so that the end of the least time is no event of its own.
                        action.least = Ticks::ZERO;
                    }
                    begun
                });
                self.running.insert(key, begun);
            }
        }
    }

    /// The zone of the run, and for each uncertain time that has ended the two zones in which it is as short and as long as it may be.
    pub fn ends(&self) -> Vec<Dbm> {
        let zone = self.guide.zone();
        let ends = self
            .ended
            .iter()
            .flat_map(|ended| [false, true].map(|is_long| at_end(&zone, ended.took, is_long)));
        std::iter::once(zone.clone()).chain(ends.flatten()).collect()
    }

    /// The uncertain times with their bounds.
    pub fn told(&self) -> Vec<(Number, TimeRange)> {
        let range = |timed, took, [least, most]: [Ticks; 2], has_ended| {
            let [from, to] =
                self.guide.bounds(took).map(|bound| bound.and_then(|bound| u64::try_from(bound).ok()));
            let declared_most = (most != Running::FOREVER).then_some(most.0);
            let most = if has_ended { to } else { declared_most };
            TimeRange {
                timed,
                least: from.unwrap_or(0).max(least.0),
                most: most.into_iter().chain(declared_most).min(),
                declared_least: least.0,
                declared_most,
                has_ended,
            }
        };
        let mut all = Vec::new();
        for Ended { number, step, timed, took, declared } in &self.ended {
            // A lost packet does not arrive at any time.
            if matches!(step, CellMove::Acted(..) | CellMove::Deliver(_) | CellMove::Mend(..)) {
                all.push((*number, range(timed.clone(), *took, *declared, true)));
            }
        }
        for Ended { number, timed, took, declared, .. } in self.not_ended() {
            all.push((number, range(timed, took, declared, false)));
        }
        all
    }

    /// The actions and packets that are not over, as if they ended now: an action in any way, and a packet by its arrival.
    fn not_ended(&self) -> impl Iterator<Item = Ended> {
        let cell = &self.cell.cell;
        let actions = self.running.iter().filter_map(|(&(task, level), begun)| {
            let step = CellMove::GoOn(task, level);
            let (timed, took) = (self.action(task, begun), self.since(begun.at));
            let number = self.numbers.of(cell, step)?;
            Some(Ended { number, step, timed, took, declared: [begun.least, begun.most] })
        });
        let packets = (0_u8..).zip(&cell.in_flight).filter_map(|(at, carried)| {
            let (from, to, bound) = cell.links[usize::from(carried.link)];
            let (step, bound) = (CellMove::Deliver(at), Ticks(bound.into()));
            let timed = Timed::Packet { port: carried.packet.port, from, to };
            let (number, took) = (self.numbers.of(cell, step)?, symbol_of(carried.age)?);
            Some(Ended { number, step, timed, took, declared: [Ticks(1).min(bound), bound] })
        });
        actions.chain(packets)
    }
}
