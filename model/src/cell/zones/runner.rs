//! Runs the moves of a cell on symbolic times, from one kept state to the next.

use crate::cell::judge::{Reached, Shown, judge, nothing_reached};
use crate::cell::plan::{CellFaults, CellPlan};
use crate::cell::run_state::canon::Left;
use crate::cell::run_state::{CellMove, RunState};
use crate::cell::standstill::is_outside;
use crate::cell::verdict::{Kind, Phase};
use crate::cell::waiting::for_ever;
use crate::state::Violation;
use crate::zone::dbm::Dbm;
use crate::zone::forks::{Forks, again};
use crate::zone::times::symbol_of;
use imrs_protocol::symbolic::{self, START, Symbol};
use imrs_protocol::{Instant, Ticks};
use std::sync::Arc;

/// The first byte of a control: `QUIET` if time passes next, `CHOICE` if several moves are possible.
pub(super) const QUIET: u8 = 1;
pub(super) const CHOICE: u8 = 0;

/// After this many moves without an alternative, a state is kept in any case.
const WALK: usize = 512;

/// Where a run begins.
#[derive(Clone, Copy)]
pub enum From<'a> {
    /// The run begins at the start of the cell.
    Start,
    /// The run begins in the kept state with this control.
    Kept(&'a [u8]),
}

/// A run from one kept state to the next one, in one of the ways that its times allow.
#[derive(Default)]
pub struct Run {
    pub moves: Vec<CellMove>,
    /// The findings of the run, each with the number of moves to it.
    pub hits: Vec<(Shown, usize)>,
    /// The control of the state at the run's end; `None` if the search does not continue from it.
    pub control: Option<Box<[u8]>>,
    /// The instant of the run's last move. The next field is the variable for the instant until which nothing happens
    /// after that move.
    pub now: i64,
    pub silent_until: Option<u8>,
    /// Whether the run had a fault or a restart. The next field says whether the run made progress or came to an end.
    pub takes_fault: bool,
    pub gets_on: bool,
    /// Whether some state of the run had no packed form.
    pub outgrown: bool,
}

impl Run {
    fn note(&mut self, shown: Option<Shown>) {
        let at = self.moves.len();
        let new = shown.filter(|new| !self.hits.iter().any(|(known, _)| known.is_same(new)));
        self.hits.extend(new.map(|shown| (shown, at)));
    }

    /// Notes that the state at the run's end has no packed form.
    fn has_no_form(&mut self, violation: Violation) {
        match violation {
            Violation::Overflow => self.outgrown = true,
            _ => self.note(Some(Shown::whole(Kind::Machine, violation.text()))),
        }
    }

    /// Whether only time has passed in this run, once, and no event has happened.
    fn is_untouched(&self) -> bool {
        let mut later = self.moves.iter().skip(1);
        self.moves.first() == Some(&CellMove::Pass) && later.all(|&step| puts_off(step))
    }
}

/// Whether a move puts off the end of an action or the arrival of a packet. Such a move is no event.
pub(super) const fn puts_off(step: CellMove) -> bool {
    matches!(step, CellMove::GoOn(..) | CellMove::Stay(_))
}

/// The moves that remain after the reduction [`leave_out`](Runner::leave_out), at one point of the runs from one state.
pub(super) struct LeftOut {
    /// The answers of the run up to that point: how it decided the comparisons of times that the zone left open. The
    /// next field is the number of moves made up to that point.
    pub answers: Vec<u16>,
    pub made: usize,
    pub moves: Vec<CellMove>,
}

/// Runs a cell.
pub struct Runner {
    phase: Phase,
    /// The cell at its start, where no time is symbolic yet.
    pub(super) start: RunState,
    pub(super) run_state: RunState,
    /// A second state, into which the reductions load states that the run itself does not reach.
    pub(super) other: RunState,
    /// The results of the reduction [`leave_out`](Self::leave_out) in the runs from the present kept state.
    pub(super) left: Vec<LeftOut>,
    /// The number of moves after which the run's state was packed last.
    pub(super) packed_at: Option<usize>,
    /// Whether the reductions that only a search by zones makes are switched off.
    pub(super) is_plain: bool,
    /// For a run that begins with the passing of time: the bounds on the time that may pass in its first state.
    limits: Vec<Ticks>,
    pub reached: Reached,
    pub mattered: Vec<bool>,
    pub moves: u64,
}

impl Runner {
    pub fn new(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Self {
        // Numbers can be packed into the key by which a queue sorts. Symbolic times (differences of variables) cannot, so
        // a queue within a zone (a set of bounds on these variables) compares its entries one by one. The start is built
        // within a zone, because all queues of a run must sort in one way.
        let (mut start, _) = again(&Dbm::zero(), &[], |_| RunState::new(plan, faults));
        start.cell.is_symbolic = true;
        let reached = nothing_reached(&start);
        Self {
            phase,
            run_state: start.clone(),
            other: start.clone(),
            left: Vec::new(),
            packed_at: None,
            start,
            is_plain: plan.everything,
            limits: Vec::new(),
            reached,
            mattered: vec![false; plan.checks.len()],
            moves: 0,
        }
    }

    /// The remaining faults in a control, and the control's other bytes.
    pub fn split<'a>(&self, control: &'a [u8]) -> (Left, &'a [u8]) {
        self.start.split(control.get(1..).unwrap_or_default())
    }

    /// Forgets the results of [`left`](Self::left). Called before the runs from another kept state.
    pub fn begin_state(&mut self) {
        self.left.clear();
    }

    /// Makes one run; `forks` answers its comparisons of times. `is_sampled`: whether the invariants of the machines
    /// are checked.
    pub fn run(&mut self, forks: &Forks, from: From<'_>, is_sampled: bool) -> Run {
        self.limits.clear();
        let mut run = Run::default();
        let mut step = None;
        self.run_state.cell.is_sampled = is_sampled;
        self.packed_at = None;
        match from {
            From::Start => {
                self.run_state.clone_from(&self.start);
                self.look(&mut run);
            }
            From::Kept(control) => {
                self.run_state.load_kept(control.get(1..).unwrap_or_default());
                self.packed_at = Some(0);
                if control.first() == Some(&QUIET) {
                    step = Some(CellMove::Pass);
                    run.now = 1;
                    self.limits.extend(self.run_state.limits());
                }
            }
        }
        // In the first state of a run, the run itself chooses a move. At a later state with a choice the run ends, and
        // that state is kept.
        let may_choose = match from {
            From::Start => false,
            From::Kept(_) => step.is_none() || !self.is_plain,
        };
        self.go(forks, step, may_choose, &mut run);
        self.mattered.iter_mut().zip(&self.run_state.mattered).for_each(|(all, one)| *all |= one);
        run
    }

    /// Makes moves until the run reaches a state that is to be kept.
    fn go(&mut self, forks: &Forks, mut step: Option<CellMove>, mut may_choose: bool, run: &mut Run) {
        let mut moves = Vec::new();
        loop {
            if let Some(step) = step.take() {
                self.apply(step, run);
                self.look(run);
            }
            if run.hits.iter().any(|(shown, _)| shown.last) {
                run.gets_on = true;
                return;
            }
            moves.clear();
            self.run_state.moves(&mut moves);
            moves.retain(|&step| !self.must_end(forks, step));
            if !moves.iter().any(|step| !matches!(step, CellMove::Crash(_) | CellMove::Restart(_))) {
                run.note(for_ever(&self.run_state, false));
                run.gets_on = true;
                if moves.is_empty() {
                    return;
                }
            }
            if !run.moves.is_empty() {
                run.note(for_ever(&self.run_state, true));
            }
            if moves.len() > 1
                && let Err(violation) = self.leave_out(forks, run, &mut moves, may_choose)
            {
                return run.has_no_form(violation);
            }
            let taken = match moves[..] {
                [CellMove::Pass] => CellMove::Pass,
                [only] if run.moves.len() < WALK => only,
                _ if may_choose => {
                    let taken = moves[forks.choose(moves.len())];
                    // A move that only puts something off is no event. The state after it is not worth keeping, so the
                    // run goes on.
                    may_choose = !self.is_plain && puts_off(taken);
                    taken
                }
                _ => return self.keep(forks, CHOICE, (START, run.now), run),
            };
            if taken == CellMove::Pass {
                return self.be_silent(forks, run);
            }
            self.take_times(forks, taken);
            step = Some(taken);
        }
    }

    /// The most time of the action that goes on in a move.
    fn most_of(&self, step: CellMove) -> Option<Ticks> {
        let CellMove::GoOn(task, level) = step else { return None };
        let actor = self.run_state.cell.bodies[usize::from(task)].actor.as_ref()?;
        actor.runs(level).map(|action| action.most)
    }

    /// Whether the action that goes on in this move must end.
    fn must_end(&self, forks: &Forks, step: CellMove) -> bool {
        self.most_of(step).is_some_and(|most| forks.cut().is_surely_at_most(most, Ticks::ZERO))
    }

    /// Restricts the present times to those at which the move is possible.
    fn take_times(&self, forks: &Forks, step: CellMove) {
        let most = self.most_of(step).and_then(symbol_of);
        if let Some(Symbol { first, second, offset }) = most {
            let goes_on = Symbol { first, second, offset: offset - 1 };
            forks.cut().keep(goes_on).expect("some time is left");
        }
    }

    fn apply(&mut self, step: CellMove, run: &mut Run) {
        self.moves += 1;
        run.moves.push(step);
        run.takes_fault |= is_outside(step);
        let further = self.run_state.progresses(step);
        run.gets_on |= further != Some(false);
        if further.is_none() {
            self.run_state.clone_from(&self.start);
            self.run_state.cell.violation = Some(Violation::Panic);
        }
    }

    /// Judges the last move of the run.
    fn look(&mut self, run: &mut Run) {
        let shown = judge(&mut self.run_state, self.phase, &mut self.reached);
        shown.into_iter().for_each(|shown| run.note(Some(shown)));
    }

    /// Lets all ticks pass before the next tick in which something may happen.
    fn be_silent(&mut self, forks: &Forks, run: &mut Run) {
        if !self.is_plain && self.goes_round(forks, run) {
            return;
        }
        self.run_state.end_instant();
        self.run_state.next_step();
        let limits: Vec<Ticks> = self.run_state.limits().collect();
        if limits.iter().any(|limit| limit.is_zero()) {
            return self.keep(forks, QUIET, (START, run.now), run);
        }
        let until = forks.cut().add();
        let not_before = Symbol { first: until, second: START, offset: -run.now };
        forks.cut().keep(not_before).expect("a new variable may have any value");
        let now = Instant(run.now.unsigned_abs());
        let silent = symbolic::instant(until) - now;
        for limit in limits {
            let left = limit - silent;
            if let Some(Symbol { first, second, offset }) = symbolic::symbol(left.0) {
                let longer = Symbol { first, second, offset: offset - 1 };
                forks.cut().keep(longer).expect("a tick is left");
            }
        }
        run.silent_until = Some(until);
        let elapsed = self.run_state.elapse(silent, None);
        let is_silent = self.run_state.beside.acted == 0 && self.run_state.broken.is_empty();
        if let Err(violation) = elapsed.and_then(|()| is_silent.then_some(()).ok_or(Violation::Invariant)) {
            return run.note(Some(Shown::whole(Kind::Machine, violation.text())));
        }
        self.keep(forks, QUIET, (until, 0), run);
    }

    /// Whether only a tick has passed since a kept state, and no bound of that state is reached. Then the kept state
    /// includes the present times, because it was kept for every number of ticks in which nothing happens.
    fn goes_round(&self, forks: &Forks, run: &Run) -> bool {
        let is_left = |limit: &Ticks| forks.cut().is_surely_at_most(Ticks(2), *limit);
        !self.limits.is_empty()
            && run.is_untouched()
            && self.run_state.beside.acted == 0
            && self.limits.iter().all(is_left)
    }

    /// Packs the state at which the run ends, so that it can be kept.
    fn keep(&mut self, forks: &Forks, kind: u8, now: (u8, i64), run: &mut Run) {
        match self.pack_for(forks, kind, now, run.moves.len()) {
            Ok(()) => {
                let control = [&[kind], self.run_state.packed()].concat();
                run.control = Some(control.into());
            }
            Err(violation) => run.has_no_form(violation),
        }
    }

    fn pack_for(&mut self, forks: &Forks, kind: u8, now: (u8, i64), made: usize) -> Result<(), Violation> {
        // The reductions may have packed a state with a choice already.
        if kind == CHOICE && self.packed_at == Some(made) {
            return Ok(());
        }
        if !self.is_plain {
            self.loosen(forks, now.0);
        }
        forks.cut().begin_to_pack(now);
        self.run_state.pack()
    }
}
