//! The claims: sentences of the paper or of a decision, each with the state spaces whose search decides it. A claim holds
//! under the default rules, and fails, with its shortest counterexample, under each named variant.

mod cell_states;
mod commands;
mod couples;
mod exchange;
mod larger;
mod margins;
mod meeting;
mod meetings;
mod pinned;
mod service;
mod timing;

use crate::cell_state::plan::CellScenario;
use crate::cell_state::{draw_cell_state, explore_cell_state};
use crate::chart::{Counterexample, draw};
use crate::explore::{Exploration, Limits, explore};
use crate::report::{Bounds, Found, Outcome, Report, Verdict, collision_probability};
use crate::scenario::Scenario;
use crate::side_by_side::side_by_side;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Which claims to check, and with which resources.
#[derive(Clone, Debug)]
pub struct Options {
    /// Whether to search within the large bounds.
    pub full: bool,
    /// The name of the only claim to check; `None`: all claims.
    pub claim: Option<String>,
    /// How many claims are checked at the same time.
    pub jobs: usize,
    /// The greatest resident memory of the process, in bytes.
    pub memory: u64,
}

/// Receives the progress of a check, from several threads.
pub trait Progress: Sync {
    /// A claim begins.
    fn started(&self, name: &str, rule: &str, parties: u32) {
        let _ = (name, rule, parties);
    }
    /// A claim has explored this many states so far.
    fn states(&self, name: &str, states: u64) {
        let _ = (name, states);
    }
    /// A claim has been settled.
    fn finished(&self, verdict: &Verdict) {
        let _ = verdict;
    }
}

/// A [`Progress`] that ignores all reports.
#[derive(Clone, Copy, Debug)]
pub struct Silent;

impl Progress for Silent {}

/// One claim under one rule, before it is checked.
pub(crate) struct Claim {
    pub name: &'static str,
    pub rule: &'static str,
    pub parties: u32,
    pub about: &'static str,
    pub expect: Outcome,
    /// Whether the claim belongs to the quick run with small bounds.
    pub smoke: bool,
    pub settle: Box<dyn Fn(&mut Work<'_>) -> Settled + Send + Sync>,
}

/// The result of settling a claim.
pub(crate) struct Settled {
    pub outcome: Outcome,
    pub bounds: Bounds,
    pub found: Found,
    pub counterexample: Option<Counterexample>,
    /// Whether the claim's own checks passed: the search found every number for which it looks, and the claim does not hold
    /// vacuously.
    pub sound: bool,
    /// A variant of the claim that must fail, and whose verdict came from the same search.
    pub variant: Option<Box<Variant>>,
}

impl Settled {
    /// The result of a search that looked for no numbers.
    fn new(outcome: Outcome, bounds: Bounds, counterexample: Option<Counterexample>) -> Self {
        Self { outcome, bounds, found: Found::NOTHING, counterexample, sound: true, variant: None }
    }

    /// The result if a budget ended the search before the claim was settled.
    fn unsettled(bounds: Bounds) -> Self {
        Self { sound: false, ..Self::new(Outcome::Unknown, bounds, None) }
    }
}

/// A variant of a claim whose verdict comes from the same search as another claim's.
pub(crate) struct Variant {
    pub rule: &'static str,
    pub about: &'static str,
    pub settled: Settled,
    pub counts: Counts,
}

/// How much some searches have explored.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counts {
    states: u64,
    transitions: u64,
    depth: u64,
    longest_state: u64,
    complete: bool,
    seconds: f64,
}

impl Counts {
    const NONE: Self =
        Self { states: 0, transitions: 0, depth: 0, longest_state: 0, complete: true, seconds: 0.0 };

    fn add(&mut self, more: &Self) {
        self.states += more.states;
        self.transitions += more.transitions;
        self.depth = self.depth.max(more.depth);
        self.longest_state = self.longest_state.max(more.longest_state);
        self.complete &= more.complete;
        self.seconds += more.seconds;
    }
}

/// A state space that a claim explores.
#[derive(Clone, Debug)]
pub(crate) enum Explored {
    World(Arc<Scenario>),
    CellState(Arc<CellScenario>),
}

/// The first state space that is explored for a claim.
pub(crate) fn first_explored(name: &str) -> Option<Explored> {
    // A budget of one state is enough to find out which state space is explored first.
    let limits = Limits { states: 1, ..Limits::default() };
    all().into_iter().filter(|claim| claim.name == name).find_map(|claim| {
        let mut work =
            Work { first: None, name: claim.name, limits, progress: &Silent, counts: Counts::NONE };
        let _ = (claim.settle)(&mut work);
        work.first
    })
}

/// The explorations that settle one claim.
pub(crate) struct Work<'a> {
    /// The first state space that was explored.
    first: Option<Explored>,
    name: &'static str,
    limits: Limits,
    progress: &'a (dyn Progress + 'a),
    counts: Counts,
}

impl Work<'_> {
    /// Explores a scenario for the claim.
    pub fn explore(&mut self, scenario: &Arc<Scenario>) -> Exploration {
        self.first.get_or_insert_with(|| Explored::World(Arc::clone(scenario)));
        let found = explore(scenario, self.limits, None);
        self.count(&found);
        found
    }

    fn count<A>(&mut self, found: &Exploration<A>) {
        self.counts.add(&Counts {
            states: found.states,
            transitions: found.transitions,
            depth: found.depth,
            longest_state: found.longest_state,
            complete: found.complete,
            seconds: found.seconds,
        });
        self.progress.states(self.name, self.counts.states);
    }

    /// Explores a whole cell. Returns the outcome, and the counterexample if there is one.
    pub fn judge_cell_state(&mut self, plan: &Arc<CellScenario>) -> (Outcome, Option<Counterexample>) {
        self.first.get_or_insert_with(|| Explored::CellState(Arc::clone(plan)));
        let found = explore_cell_state(plan, self.limits);
        self.count(&found);
        (outcome(&found), unless_it_panics(|| draw_cell_state(plan, &found)))
    }

    /// The number of distinct states explored so far.
    pub const fn states(&self) -> u64 {
        self.counts.states
    }

    /// Runs a part of the work. Returns its result, and the counts of that part alone.
    pub fn part<R>(&mut self, part: impl FnOnce(&mut Self) -> R) -> (R, Counts) {
        let before = std::mem::replace(&mut self.counts, Counts::NONE);
        let result = part(self);
        let counts = self.counts;
        self.counts = before;
        self.counts.add(&counts);
        (result, counts)
    }

    /// Explores a scenario. Returns the outcome, and the counterexample if there is one.
    pub fn judge(&mut self, scenario: &Arc<Scenario>) -> (Outcome, Option<Counterexample>) {
        let found = self.explore(scenario);
        (outcome(&found), unless_it_panics(|| draw(scenario, &found)))
    }
}

/// Draws the chart of a counterexample. Drawing repeats the counterexample's transitions; `None` if the last of them
/// panics.
pub(crate) fn unless_it_panics<T>(draw: impl FnOnce() -> Option<T>) -> Option<T> {
    catch_unwind(AssertUnwindSafe(draw)).unwrap_or(None)
}

/// The outcome that follows from one exploration.
pub(crate) fn outcome<A>(found: &Exploration<A>) -> Outcome {
    match (found.violation, found.complete) {
        (Some(_), _) => Outcome::Fails,
        (None, true) => Outcome::Holds,
        (None, false) => Outcome::Unknown,
    }
}

fn all() -> Vec<Claim> {
    let mut claims = meetings::claims();
    claims.extend(commands::claims());
    claims.extend(cell_states::claims());
    claims.extend(service::claims());
    claims.extend(couples::claims());
    claims.extend(timing::claims());
    claims
}

/// The names of all claims, in order, without duplicates.
#[must_use]
pub fn claim_names() -> Vec<&'static str> {
    let mut names: Vec<&'static str> = Vec::new();
    for claim in all() {
        if !names.contains(&claim.name) {
            names.push(claim.name);
        }
    }
    names
}

/// Settles the protocol's claims, and reports all verdicts.
pub fn verify(options: &Options, progress: &dyn Progress) -> Report {
    let wanted = |claim: &Claim| match &options.claim {
        Some(name) => claim.name == name && (claim.smoke || options.full),
        None => claim.smoke || options.full,
    };
    let claims: Vec<Claim> = all().into_iter().filter(wanted).collect();
    let limits = Limits { memory: options.memory, ..Limits::default() };
    let next = AtomicUsize::new(0);
    let verdicts: Mutex<Vec<(usize, Verdict)>> = Mutex::new(Vec::new());
    // Claims run in parallel, because a second thread in one exploration gains little.
    side_by_side(0..options.jobs.clamp(1, claims.len().max(1)), |_| {
        while let Some((at, claim)) = take(&claims, &next) {
            for verdict in settle(claim, limits, progress) {
                progress.finished(&verdict);
                verdicts.lock().unwrap_or_else(PoisonError::into_inner).push((at, verdict));
            }
        }
    });
    let mut verdicts = verdicts.into_inner().unwrap_or_else(PoisonError::into_inner);
    verdicts.sort_by_key(|(at, _)| *at);
    Report { version: 1, cell: None, claims: verdicts.into_iter().map(|(_, verdict)| verdict).collect() }
}

fn take<'a>(claims: &'a [Claim], next: &AtomicUsize) -> Option<(usize, &'a Claim)> {
    let at = next.fetch_add(1, Ordering::Relaxed);
    claims.get(at).map(|claim| (at, claim))
}

/// Searches for the verdict of a claim, and for the verdict of the variant that the same search decides, if there is one.
fn settle(claim: &Claim, limits: Limits, progress: &dyn Progress) -> Vec<Verdict> {
    progress.started(claim.name, claim.rule, claim.parties);
    let mut work = Work { first: None, name: claim.name, limits, progress, counts: Counts::NONE };
    let mut settled = (claim.settle)(&mut work);
    let variant = settled.variant.take();
    let row = (claim.name, claim.rule, claim.parties, settled.bounds.loss);
    settled.sound &= pinned::agrees(row, &settled.found);
    let mut verdicts = vec![verdict(claim, claim.rule, claim.about, claim.expect, settled, &work.counts)];
    if let Some(variant) = variant {
        let Variant { rule, about, settled, counts } = *variant;
        verdicts.push(verdict(claim, rule, about, Outcome::Fails, settled, &counts));
    }
    verdicts
}

fn verdict(
    claim: &Claim,
    rule: &str,
    about: &str,
    expect: Outcome,
    settled: Settled,
    counts: &Counts,
) -> Verdict {
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a rate"
    )]
    let states_per_second = (counts.states as f64 / counts.seconds.max(1e-9)) as u64;
    Verdict {
        name: claim.name.into(),
        rule: rule.into(),
        parties: claim.parties,
        about: about.into(),
        expect,
        outcome: settled.outcome,
        as_expected: settled.outcome == expect && settled.sound,
        bounds: settled.bounds,
        states: counts.states,
        transitions: counts.transitions,
        depth: u32::try_from(counts.depth).unwrap_or(u32::MAX),
        complete: counts.complete,
        collision_probability: collision_probability(counts.states),
        longest_state: counts.longest_state,
        seconds: counts.seconds,
        states_per_second,
        found: settled.found,
        counterexample: settled.counterexample,
    }
}
