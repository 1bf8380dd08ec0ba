//! Runs a cell at random on the protocol's state machine, in one process and without packing: for cells that are too large to
//! search, and for longer runs than a search reaches.
//!
//! ```text
//!   seed ---> faults, and a stream of numbers for each chooser ---.
//!                                                                 v
//!   schedule (faults + tape) ----------------------------------> run ---> what it shows, judged as a search judges it
//!      ^                                                          |
//!      '--- shrinking: fewer faults, smaller numbers, zeros <-----'
//! ```
//!
//! A run makes only moves of the search at every tick. So a complete search with the same faults finds whatever a run finds. Runs
//! give no verdicts that need a complete search (a statement is unreachable, a check never applies), and no warnings.

mod draw;
mod driver;
mod run;
mod schedule;
mod shrink;

pub use run::Ended;
pub use schedule::{Chooser, Fault, MOST_FAULTS, Schedule, Tape};

use super::alike::shows_alike;
use super::judge::{Reached, Shown};
use super::look::too_large;
use super::missed::Missed;
use super::outside::with_programs;
use super::plan::{CellFaults, CellPlan, Conduct, Times};
use super::run_state::RunState;
use super::story;
use super::verdict::{Finding, Phase, Refused};
use crate::chart::{Folding, chart};
use crate::side_by_side::side_by_side;
use draw::Census;
use driver::Source;
use imrs_protocol::TaskId;
use imrs_protocol::script::Address;
use run::{Limit, Run, run};
use schedule::idle;
use shrink::{Shrinker, moves_to};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// The number of runs of one thread between two reports of the progress.
const BATCH: u64 = 64;

/// The result of random runs.
#[derive(Debug, Default)]
pub struct Simulated {
    /// The number of complete runs.
    pub runs: u64,
    /// The number of runs with faults.
    pub with_faults: u64,
    /// The number of moves of all runs.
    pub steps: u64,
    /// The number of ticks of all runs.
    pub ticks: u64,
    /// The number of runs for each way to end, in the order of [`Ended`].
    pub ended: [u64; 4],
    /// Each different finding once, in the order of the seeds.
    pub found: Vec<Found>,
    /// For each task, the number of its statements that were reached, and of all its statements.
    pub statements: Vec<(u32, u32)>,
    /// The statements that no run reached: task and operation.
    pub not_reached: Vec<(TaskId, Address)>,
    /// The given faults that happened in no run.
    pub idle: Vec<Fault>,
    /// Whether the runs were stopped before their end.
    pub interrupted: bool,
}

/// A finding, and the schedule that shows it.
#[derive(Debug)]
pub struct Found {
    /// The first seed whose run shows the finding; `None` for a given schedule.
    pub seed: Option<u64>,
    /// The finding's number, from 1, among the findings of that seed's run, or among those of the given schedule.
    pub number: usize,
    /// The finding's number among the findings of the run of `schedule`.
    pub number_of_schedule: usize,
    /// The number of runs that show the finding.
    pub runs: u64,
    /// A schedule that shows the finding.
    pub schedule: Schedule,
    /// The finding that the schedule shows. Its moves belong to a plan whose only fault hypothesis is `faults`.
    pub finding: Finding,
    /// The budgets of the schedule's faults.
    pub faults: CellFaults,
    /// The size of the schedule before shrinking; `None` if the schedule was not shrunk.
    pub shrunk: Option<Shrunk>,
}

/// The size of a schedule before shrinking.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shrunk {
    /// The number of faults in the schedule.
    pub faults: usize,
    /// The number of choices in the schedule other than 0.
    pub choices: usize,
    /// The number of moves from the start to the finding.
    pub moves: usize,
    /// Whether shrinking came to its end. If not, it was stopped, or took too many steps.
    pub whole: bool,
}

/// The result of the run of one seed.
struct Ran {
    seed: u64,
    steps: u64,
    ticks: u64,
    ended: Ended,
    with_faults: bool,
    reached: Reached,
    /// The findings of the run, each with the number of moves to it.
    shown: Vec<(usize, Shown)>,
    /// The faults of the run, and its choices if the run shows a finding.
    schedule: Schedule,
    happened: Vec<bool>,
}

/// A finding that several runs show, at one task or at several tasks with the same statements.
struct Group {
    /// The finding as the first run shows it. The next field is the number of moves to the finding.
    shown: Shown,
    moves: usize,
    /// The other tasks that show the finding.
    also: Vec<TaskId>,
    runs: u64,
    /// The seed of the first run with this finding.
    seed: Option<u64>,
    /// The number of the finding in that run, from 1.
    number: usize,
    schedule: Schedule,
}

/// A cell to run at random.
#[derive(Debug)]
pub struct Simulator {
    plan: Arc<CellPlan>,
    /// The greatest number of steps of a run.
    steps: u32,
    census: Census,
    jobs: usize,
    stop: Arc<AtomicBool>,
}

impl Simulator {
    /// A simulator of this cell, whose runs have at most `steps` steps.
    ///
    /// # Errors
    /// [`Refused`] for a cell that is too large.
    pub fn new(plan: &Arc<CellPlan>, steps: u32) -> Result<Self, Refused> {
        if let Some(refused) = too_large(plan) {
            return Err(refused);
        }
        let plan = with_programs(plan).timed(Times::Every);
        let plain = run(&plan, &[], Source::Tape(&Tape::new()), Limit { steps, stop: None });
        let links = RunState::new(&plan, &CellFaults::default()).cell.links;
        let census = Census::of(&plan, &links, &plain);
        Ok(Self { census, steps, jobs: plan.jobs.max(1), plan, stop: Arc::default() })
    }

    /// Sets the flag that stops runs and shrinking at their next step. The result then has what was found so far.
    #[must_use]
    pub fn stopped_by(self, stop: &Arc<AtomicBool>) -> Self {
        Self { stop: Arc::clone(stop), ..self }
    }

    /// Runs `count` seeds from the first one on, with these faults or with those that each seed draws, and shrinks the
    /// schedules of their findings. Before each batch `progress` gets the number of runs and of findings. The result is the
    /// same for any number of threads.
    pub fn seeds(
        &self,
        (first, count): (u64, u64),
        faults: Option<&[Fault]>,
        progress: &mut dyn FnMut(u64, usize),
    ) -> Simulated {
        let mut all = Simulated::default();
        let mut reached: Option<Reached> = None;
        let mut groups: Vec<Group> = Vec::new();
        let mut happened = vec![false; faults.map_or(0, <[Fault]>::len)];
        while all.runs < count {
            progress(all.runs, groups.len());
            all.interrupted = self.stop.load(Ordering::Relaxed);
            if all.interrupted {
                break;
            }
            let batch = (count - all.runs).min(BATCH * self.jobs as u64);
            for mut ran in self.batch(first.wrapping_add(all.runs), batch, faults) {
                all.count(ran.steps, ran.ticks, ran.ended, ran.with_faults);
                happened.iter_mut().zip(&ran.happened).for_each(|(all, one)| *all |= one);
                let own = std::mem::take(&mut ran.reached);
                reached = Some(match reached {
                    Some(reached) => reached.join(own),
                    None => own,
                });
                self.gather(&mut groups, &ran.shown, Some(ran.seed), &ran.schedule);
            }
        }
        all.found = groups.iter().map(|group| group.of_all(self.shrink(group))).collect();
        self.coverage(&mut all, reached.as_ref());
        all.idle = faults.map_or_else(Vec::new, |faults| idle(faults, &happened));
        all
    }

    /// Adds a run's findings to the groups of equal findings. A run with one finding at several tasks counts once.
    fn gather(
        &self,
        groups: &mut Vec<Group>,
        all: &[(usize, Shown)],
        seed: Option<u64>,
        schedule: &Schedule,
    ) {
        let mut counted = Vec::new();
        for (moves, shown) in all {
            let known = groups.iter().position(|group| self.is_one(&group.shown, shown));
            let at = known.unwrap_or_else(|| {
                let (shown, schedule, also) = (shown.clone(), schedule.clone(), Vec::new());
                let number = counted.len() + 1;
                groups.push(Group { shown, moves: *moves, also, runs: 0, seed, number, schedule });
                groups.len() - 1
            });
            let group = &mut groups[at];
            if !counted.contains(&at) {
                counted.push(at);
                group.runs += 1;
            }
            let task = shown.task.filter(|_| shown.task != group.shown.task).map(TaskId::from_index);
            group.also.extend(task.filter(|task| !group.also.contains(task)));
        }
    }

    /// Whether two findings count as the same finding.
    fn is_one(&self, one: &Shown, other: &Shown) -> bool {
        one.is_same(other) || shows_alike(&self.plan, one, other)
    }

    fn batch(&self, first: u64, count: u64, faults: Option<&[Fault]>) -> Vec<Ran> {
        let done: Vec<OnceLock<Ran>> = (0..count).map(|_| OnceLock::new()).collect();
        let next = AtomicUsize::new(0);
        let work = |_| {
            while let at = next.fetch_add(1, Ordering::Relaxed)
                && let Some(place) = done.get(at)
            {
                let Some(ran) = self.seed(first.wrapping_add(at as u64), faults) else { break };
                // No other thread runs this seed, so the entry for its result is empty.
                let _ = place.set(ran);
            }
        };
        side_by_side((0..self.jobs as u64).take(count as usize), work);
        // If a run was stopped, the runs of later seeds are dropped, so that the result covers seeds without a gap.
        done.into_iter().map_while(OnceLock::into_inner).collect()
    }

    /// The faults of a run with this seed.
    fn faults(&self, seed: u64, faults: Option<&[Fault]>) -> Vec<Fault> {
        faults.map_or_else(|| self.census.draw(&self.plan, seed), <[Fault]>::to_vec)
    }

    /// The run of a seed; `None` if the run was stopped.
    fn seed(&self, seed: u64, faults: Option<&[Fault]>) -> Option<Ran> {
        let faults = self.faults(seed, faults);
        let run = run(&self.plan, &faults, Source::Seed(seed), self.until_stopped());
        if run.stopped {
            return None;
        }
        let tape = if run.shown.is_empty() { Tape::new() } else { run.tape };
        Some(Ran {
            seed,
            steps: run.moves.len() as u64,
            ticks: run.ticks,
            ended: run.ended,
            with_faults: !faults.is_empty(),
            reached: run.reached,
            shown: run.shown,
            schedule: Schedule { faults, tape },
            happened: run.happened,
        })
    }

    fn until_stopped(&self) -> Limit<'_> {
        Limit { stop: Some(&self.stop), ..self.whole() }
    }

    /// A limit without a stop flag, for a run that must not be stopped.
    const fn whole(&self) -> Limit<'_> {
        Limit { steps: self.steps, stop: None }
    }

    /// Runs a schedule, and shrinks it for each of its findings if asked to.
    #[must_use]
    pub fn schedule(&self, schedule: &Schedule, shrink: bool) -> Simulated {
        let mut all = Simulated::default();
        let run = run(&self.plan, &schedule.faults, Source::Tape(&schedule.tape), self.until_stopped());
        all.interrupted = run.stopped;
        if !run.stopped {
            all.count(run.moves.len() as u64, run.ticks, run.ended, !schedule.faults.is_empty());
        }
        let mut groups = Vec::new();
        self.gather(&mut groups, &run.shown, None, schedule);
        for group in &groups {
            let found = if shrink {
                self.shrink(group)
            } else {
                self.found(&run, &group.shown, schedule.clone(), None)
            };
            all.found.push(group.of_all(found));
        }
        self.coverage(&mut all, Some(&run.reached));
        all.idle = idle(&schedule.faults, &run.happened);
        all
    }

    /// A sequence chart of the run of a seed, and how the run ended.
    #[must_use]
    pub fn chart_of_seed(&self, seed: u64, faults: Option<&[Fault]>) -> String {
        self.chart(&run(&self.plan, &self.faults(seed, faults), Source::Seed(seed), self.whole()))
    }

    /// A sequence chart of the run of a schedule, and how the run ended.
    #[must_use]
    pub fn chart_of(&self, schedule: &Schedule) -> String {
        self.chart(&run(&self.plan, &schedule.faults, Source::Tape(&schedule.tape), self.whole()))
    }

    fn chart(&self, run: &Run) -> String {
        let path = story::walk(&self.plan, &run.faults, &run.moves, |_| {});
        let end = match run.ended {
            Ended::Over => "nothing happens any more",
            Ended::Found => "a finding ends the run",
            Ended::Steps => "the run has made as many steps as it may",
            Ended::Crowded => "more packets are in flight than can be numbered",
        };
        story::shorten(&chart(path.recorder.names(), &path.recorder.notes, end, Folding::Repeats))
    }

    fn shrink(&self, Group { shown, moves, schedule, .. }: &Group) -> Found {
        // Choices after the finding do not matter, so the run may end at the finding.
        let (moves, steps) = (*moves, u32::try_from(*moves).unwrap_or(u32::MAX));
        let limit = Limit { steps, stop: None };
        let mut first = run(&self.plan, &schedule.faults, Source::Tape(&schedule.tape), limit);
        let tape = std::mem::take(&mut first.tape);
        let schedule = &Schedule { faults: schedule.faults.clone(), tape };
        // A smaller schedule may need more moves, but not many more.
        let steps = self.steps.min(steps.saturating_mul(2).saturating_add(64));
        let mut shrinker = Shrinker {
            plan: &self.plan,
            shown,
            limit: Limit { steps, ..self.until_stopped() },
            best: schedule.clone(),
            spent: 0,
        };
        let whole = shrinker.shrink();
        let best = shrinker.best;
        let shrunk = Shrunk { faults: schedule.faults.len(), choices: schedule.choices(), moves, whole };
        let limit = Limit { steps, stop: None };
        let run = if best == *schedule {
            first
        } else {
            run(&self.plan, &best.faults, Source::Tape(&best.tape), limit)
        };
        self.found(&run, shown, best, Some(shrunk))
    }

    fn found(&self, run: &Run, shown: &Shown, schedule: Schedule, shrunk: Option<Shrunk>) -> Found {
        let end = moves_to(run, shown).unwrap_or(run.moves.len());
        // The cause is taken from this run, because it holds the values of this run.
        let shown = run.shown.iter().find(|(_, known)| known.is_same(shown)).map_or(shown, |(_, own)| own);
        let moves = run.moves[..end].to_vec();
        let finding = story::finding(&self.plan, (run.phase, 0), &run.faults, moves, shown);
        let mut groups = Vec::new();
        self.gather(&mut groups, &run.shown, None, &schedule);
        let number = 1 + groups.iter().take_while(|group| !self.is_one(&group.shown, shown)).count();
        let faults = run.faults.clone();
        Found { seed: None, number, number_of_schedule: number, runs: 1, schedule, finding, faults, shrunk }
    }

    fn coverage(&self, all: &mut Simulated, reached: Option<&Reached>) {
        for (number, conduct) in self.plan.tasks.iter().enumerate() {
            let (Conduct::Program { .. }, Some(reached)) = (conduct, reached) else { continue };
            let missed = Missed::of(conduct, |at| reached.statements[number][at]);
            all.statements.push(missed.counts);
            let named = |(at, _)| (TaskId::from_index(number), Address::try_from(at).unwrap_or(Address::MAX));
            all.not_reached.extend(missed.statements.into_iter().map(named));
        }
    }
}

impl Group {
    /// Adds to the finding of one run the tasks, the seed and the number of all runs that show the finding.
    fn of_all(&self, mut found: Found) -> Found {
        found.finding.also.clone_from(&self.also);
        Found { runs: self.runs, seed: self.seed, number: self.number, ..found }
    }
}

impl Simulated {
    fn count(&mut self, steps: u64, ticks: u64, ended: Ended, with_faults: bool) {
        self.runs += 1;
        self.steps += steps;
        self.ticks += ticks;
        self.with_faults += u64::from(with_faults);
        self.ended[ended as usize] += 1;
    }
}

impl Found {
    /// Whether a fault of the schedule is needed for the finding.
    #[must_use]
    pub fn with_faults(&self) -> bool {
        self.finding.phase == Phase::Faults
    }
}
