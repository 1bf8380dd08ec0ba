//! Compares the search of a cell with random walks through the same cell, whose states are never packed.
//!
//! ```text
//!   never packed   s0 --move--> s1 --move--> s2 ...      each move drawn among those that may happen
//!                   |            |            |
//!   as searched   load(store) --move--> the same script steps, next moves and bytes, and a state that the search has kept
//! ```
//!
//! If a cell has independent parts, their searches must also have found and reached everything that a walk finds and
//! reaches.
//!
//! A verdict is only as good as its packed states. No program may behave differently because of something that packing
//! omits, and a state that a reduction omits must show nothing new. The random walks check both at every step.

use super::follow::plain;
use super::judge::{Reached, Shown};
use super::outside::with_programs;
use super::parts::{only, parts};
use super::plan::{CellFaults, CellPlan, Times};
use super::run_state::{CellMove, RunState};
use super::search::{Kept, explore_and_keep};
use super::seen::Mark;
use super::unpacked::Unpacked;
use super::verdict::{Finding, Kind, Phase};
use super::waiting::deadlock;
use crate::cell_state::script::ScriptReaction;
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{Call, MessageId, ReplyTo, Round, Seq24, Signal};
use std::fmt;
use std::ops::AddAssign;
use std::sync::Arc;

/// The counts of a comparison that found no difference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// The number of searches: one without faults, and one for each fault hypothesis.
    pub searches: u32,
    /// The number of searches that covered everything.
    pub complete: u32,
    /// The number of states that the searches kept.
    pub states: u64,
    /// The number of moves of the random walks.
    pub steps: u64,
    /// The number of states of random walks that were looked up among the kept states.
    pub looked_up: u64,
    /// The number of findings whose paths were replayed.
    pub findings: u64,
    /// The number of pauses that began in random walks.
    pub pauses: u64,
    /// The number of pauses that ended in random walks.
    pub wakes: u64,
}

impl Agreement {
    /// Counts a move of a random walk.
    fn walked(&mut self, step: CellMove) {
        let begins =
            matches!(step, CellMove::Pause(..) | CellMove::PauseBefore(..) | CellMove::PauseNext(..));
        self.steps += 1;
        self.pauses += u64::from(begins);
        self.wakes += u64::from(matches!(step, CellMove::Wake(_)));
    }
}

impl AddAssign for Agreement {
    fn add_assign(&mut self, other: Self) {
        self.searches += other.searches;
        self.complete += other.complete;
        self.states += other.states;
        self.steps += other.steps;
        self.looked_up += other.looked_up;
        self.findings += other.findings;
        self.pauses += other.pauses;
        self.wakes += other.wakes;
    }
}

/// A difference between the search, whose states are packed, and a cell whose states are never packed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disagreement {
    /// What differs between the two, in words.
    pub what: String,
    /// The moves that lead to the difference.
    pub moves: Vec<CellMove>,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, after {:?}", self.what, self.moves)
    }
}

/// How much to compare.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// The number of random walks for each search.
    pub walks: u32,
    /// The greatest number of moves of one random walk.
    pub length: u32,
    /// When actions may end and packets may arrive.
    pub times: Times,
}

/// Searches a cell, and compares the result with random walks through the cell, whose states are never packed. `draw`
/// returns a number below its argument.
///
/// # Errors
/// [`Disagreement`]: the first difference.
pub fn compare_with_walks(
    plan: &Arc<CellPlan>,
    effort: Effort,
    draw: &mut dyn FnMut(usize) -> usize,
) -> Result<Agreement, Disagreement> {
    let plan = with_programs(plan).timed(effort.times);
    let mut agreement = Agreement::default();
    let hypotheses = plan.faults.iter().filter(|faults| !faults.are_none());
    let phases = std::iter::once((Phase::FaultFree, CellFaults::default()));
    for (phase, faults) in phases.chain(hypotheses.map(|faults| (Phase::Faults, faults.clone()))) {
        let kept = explore_and_keep(&plan, phase, &faults);
        agreement.searches += 1;
        agreement.complete += u32::from(kept.complete);
        agreement.states += kept.states;
        for finding in kept.findings.iter().filter(|finding| !finding.moves.is_empty()) {
            agreement.findings += 1;
            shows(&plan, phase, &faults, finding)?;
        }
        let apart = search_apart(&plan, phase, &faults)?;
        for _ in 0..effort.walks {
            let walk = Walk::new(&plan, phase, &faults, (&kept, apart.as_ref()));
            walk.go(effort.length, draw, &mut agreement)?;
        }
    }
    Ok(agreement)
}

/// What the searches of all parts of a cell found and reached.
struct Apart {
    hits: Vec<Shown>,
    reached: Reached,
}

/// Searches the parts of a cell. Returns `None` if there is only one part, if the parts cannot stand for the whole cell, or
/// if a search was incomplete.
fn search_apart(
    plan: &Arc<CellPlan>,
    phase: Phase,
    faults: &CellFaults,
) -> Result<Option<Apart>, Disagreement> {
    let mut apart: Option<Apart> = None;
    if plan.times == Times::Between || !faults.may_be_apart() {
        return Ok(None);
    }
    for part in parts(plan) {
        let plan = only(plan, Some(&part));
        let kept = explore_and_keep(&plan, phase, faults);
        if !kept.complete {
            return Ok(None);
        }
        for finding in kept.findings.iter().filter(|finding| !finding.moves.is_empty()) {
            shows(&plan, phase, faults, finding)?;
        }
        apart = Some(match apart {
            None => Apart { hits: kept.hits, reached: kept.reached },
            Some(Apart { mut hits, reached }) => {
                hits.extend(kept.hits);
                Apart { hits, reached: reached.join(kept.reached) }
            }
        });
    }
    Ok(apart)
}

/// Replays the path of a finding without packing states. The path must end in the same finding.
fn shows(
    plan: &Arc<CellPlan>,
    phase: Phase,
    faults: &CellFaults,
    finding: &Finding,
) -> Result<(), Disagreement> {
    let mut cell = Unpacked::new(plan, phase, faults);
    let mut last = cell.shown();
    for &step in &finding.moves {
        cell.take(step);
        last = cell.shown();
    }
    last.extend([false, true].into_iter().filter_map(|goes_on| deadlock(&cell.run_state, goes_on)));
    let kind = |kind| if kind == Kind::Starves { Kind::TimeOut } else { kind };
    let is = |shown: &Shown| {
        (kind(shown.kind), shown.task, shown.address, shown.check)
            == (kind(finding.kind), finding.task.map(|task| task.index()), finding.address, finding.check)
    };
    if last.iter().any(is) {
        return Ok(());
    }
    let what = format!("the path to {:?} ({}) shows {last:?}", finding.kind, finding.cause);
    Err(Disagreement { what, moves: finding.moves.clone() })
}

/// A random walk through the unpacked cell, and its twin: a copy of the same state that is packed and loaded before
/// each move.
struct Walk<'a> {
    own: Unpacked,
    twin: Unpacked,
    kept: &'a Kept,
    apart: Option<&'a Apart>,
    moves: Vec<CellMove>,
    /// Whether a restarted node is farther behind the rounds of the other members than packed states can hold. Then the
    /// walk and its twin, the copy that is packed and loaded, behave alike, but with different round numbers.
    far: bool,
    /// Whether states of the walk may be covered by a kept state (one that the search stored, and that allows all their
    /// moves) which the look-up cannot find.
    unlisted: bool,
}

impl<'a> Walk<'a> {
    fn new(
        plan: &Arc<CellPlan>,
        phase: Phase,
        faults: &CellFaults,
        (kept, apart): (&'a Kept, Option<&'a Apart>),
    ) -> Self {
        let unlisted = faults.hide_covered_states();
        let own = Unpacked::new(plan, phase, faults);
        let twin = own.clone().without_history();
        Self { twin, own, kept, apart, moves: Vec::new(), far: false, unlisted }
    }

    fn go(
        mut self,
        length: u32,
        draw: &mut dyn FnMut(usize) -> usize,
        agreement: &mut Agreement,
    ) -> Result<(), Disagreement> {
        if !self.looked_at()? {
            return self.end();
        }
        let mut here = self.own.run_state.clone().store();
        for _ in 0..length {
            let Ok(bytes) = here else { return self.end() };
            self.twin.run_state.load(&bytes);
            let (mut moves, mut others) = (Vec::new(), Vec::new());
            self.own.run_state.moves(&mut moves);
            self.twin.run_state.moves(&mut others);
            if moves != others {
                return self.differs(format!("next may happen {moves:?}, in the packed state {others:?}"));
            }
            if moves.len() > 1 && self.kept.complete && !self.far && !self.unlisted {
                agreement.looked_up += 1;
                if !self.kept.seen.covers(Mark::of(self.own.run_state.split(&bytes))) {
                    return self.differs("the search has not been in this state".into());
                }
            }
            let Some(&step) = moves.get(draw(moves.len().max(1))) else { return self.end() };
            agreement.walked(step);
            self.moves.push(step);
            self.own.take(step);
            self.twin.take(step);
            let [turns, twins] = [&self.own, &self.twin].map(|cell| turns(&cell.run_state));
            if turns != twins {
                return self.differs(format!("the scripts do {turns:?}; from the packed state {twins:?}"));
            }
            if !self.looked_at()? {
                return self.end();
            }
            let [state, packed] = [&self.own, &self.twin].map(|cell| cell.run_state.clone().store());
            let restarted = || self.moves.iter().any(|step| matches!(step, CellMove::Restart(_)));
            self.far |= state != packed && restarted();
            if state != packed && !self.far {
                return self.differs(format!(
                    "another state follows from the packed one:\n  {state:?}\n  {packed:?}"
                ));
            }
            here = state;
        }
        self.end()
    }

    /// Judges the last move of the walk and of its twin. Returns whether the walk goes on.
    fn looked_at(&mut self) -> Result<bool, Disagreement> {
        let (shown, others) = (self.own.shown(), self.twin.shown());
        if shown.len() != others.len() || shown.iter().zip(&others).any(|(a, b)| !a.is_same(b)) {
            let what = format!("shows {shown:?}, from the packed state {others:?}");
            return Err(Disagreement { what, moves: self.moves.clone() });
        }
        let is_in = |hits: &[Shown], shown: &Shown| hits.iter().any(|hit| hit.is_same(shown));
        let is_found = |shown: &Shown| !self.kept.complete || is_in(&self.kept.hits, shown);
        let is_found_apart = |shown: &Shown| self.apart.is_none_or(|apart| is_in(&apart.hits, shown));
        match shown.iter().find(|shown| !is_found(shown) || !is_found_apart(shown)) {
            Some(shown) => {
                let what = format!("the search has not found {:?}: {}", shown.kind, shown.cause);
                Err(Disagreement { what, moves: self.moves.clone() })
            }
            None => Ok(!shown.iter().any(|shown| shown.last)),
        }
    }

    /// Ends the walk: the search must have reached every operation that the walk reached.
    fn end(self) -> Result<(), Disagreement> {
        let whole = self.kept.complete.then_some(&self.kept.reached);
        for searched in whole.into_iter().chain(self.apart.map(|apart| &apart.reached)) {
            let all = self.own.reached.statements.iter().zip(&searched.statements).enumerate();
            for (task, (own, searched)) in all {
                if let Some(at) = own.iter().zip(searched).position(|(own, searched)| *own && !searched) {
                    return self.differs(format!("the search has not reached operation {at} of task {task}"));
                }
            }
        }
        Ok(())
    }

    fn differs<T>(self, what: String) -> Result<T, Disagreement> {
        Err(Disagreement { what, moves: self.moves })
    }
}

/// What the scripts did in the last move, without the numbers of messages and rounds, which differ in a packed state.
fn turns(run_state: &RunState) -> Vec<String> {
    let all = run_state.cell.turns.iter().flatten();
    let told = |turn: &ScriptReaction| {
        let ScriptReaction { task, at, input, passed, end } = turn;
        format!("{task} at {at}: {:?} -> {passed:?} {end:?}", nameless(*input))
    };
    all.map(told).collect()
}

fn nameless(input: ScriptInput) -> ScriptInput {
    let mut input = plain(input);
    let no_one = MessageId { sequence: Seq24::default(), ..MessageId::default() };
    match &mut input {
        ScriptInput::Signal(Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery))) => {
            delivery.from = ReplyTo { id: no_one, ..delivery.from };
        }
        ScriptInput::Signal(Signal::Released { round, .. } | Signal::GaveUp { round, .. }) => {
            *round = Round::default();
        }
        _ => {}
    }
    input
}
