//! Breadth-first over the states in which there is a choice; what has none is walked through.

use super::course::{CellMove, Course};
use super::judge::{self, Reached, Shown, deadlock, judge, nothing_reached};
use super::plan::{CellFaults, CellPlan, Conduct, Holds};
use super::story;
use super::verdict::{Coverage, Finding, Kind, Phase, Verdicts};
use crate::explore::resident_bytes;
use crate::state::Violation;
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, Op};
use std::collections::hash_map::DefaultHasher;
use std::collections::{HashSet, VecDeque};
use std::hash::{BuildHasherDefault, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

/// How many moves without an alternative are walked through before a state is kept.
const WALK: usize = 64;
/// How many states pass between two looks at the budget.
const LOOK: u64 = 256;

/// Hashes fingerprints to themselves.
#[derive(Default)]
struct Same(u64);

impl Hasher for Same {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.0 = self.0 << 8 | u64::from(byte));
    }
    fn write_u64(&mut self, number: u64) {
        self.0 = number;
    }
}

/// How a kept state was first reached: from which, by which of its moves, and in how many choices.
#[derive(Clone, Copy)]
struct Origin {
    parent: u32,
    choice: u16,
    depth: u16,
}

/// A finding on the move number `steps` after `origin`.
struct Hit {
    shown: Shown,
    origin: Origin,
    steps: usize,
}

struct Search {
    phase: Phase,
    course: Course,
    seen: HashSet<u64, BuildHasherDefault<Same>>,
    origins: Vec<Origin>,
    queue: VecDeque<(u32, Box<[u8]>)>,
    reached: Reached,
    hits: Vec<Hit>,
    moves: u64,
    longest: usize,
    /// Whether some state had no packed form: what follows it was not looked at.
    outgrown: bool,
}

/// What a phase comes to.
struct Done {
    coverage: Coverage,
    findings: Vec<Finding>,
    reached: Reached,
    mattered: Vec<bool>,
    /// Whether what follows some finding was not looked at.
    pruned: bool,
}

/// Checks a cell: first without faults, which says what takes no fault to go wrong, then with those declared.
#[must_use]
pub fn check_cell(plan: &Arc<CellPlan>) -> Verdicts {
    let plan = &super::outside::with_programs(plan);
    if let Some(refused) = refused(plan) {
        return Verdicts { findings: vec![refused], ..Verdicts::default() };
    }
    let none = CellFaults::default();
    let mut phases = vec![(Phase::FaultFree, none)];
    if !plan.faults.are_none() {
        phases.push((Phase::Faults, plan.faults.clone()));
    }
    let run = |(phase, faults): &(Phase, CellFaults)| explore(plan, *phase, faults);
    let done: Vec<Done> = if plan.jobs > 1 && phases.len() > 1 {
        std::thread::scope(|scope| {
            let threads: Vec<_> = phases.iter().map(|phase| scope.spawn(|| run(phase))).collect();
            threads.into_iter().filter_map(|thread| thread.join().ok()).collect()
        })
    } else {
        phases.iter().map(run).collect()
    };
    conclude(plan, done)
}

/// A program that keeps numbers of messages: no canonical state could hold them (D51).
fn refused(plan: &CellPlan) -> Option<Finding> {
    let names = |task: &Conduct| matches!(task, Conduct::Program { program, .. } if program.names_messages());
    let task = plan.tasks.iter().position(names)?;
    let cause =
        format!("{} keeps numbers of messages, which the checker cannot", judge::name(&plan.table, task));
    Some(bare(Kind::Machine, Some((TaskId::from_index(task), 0)), None, cause))
}

fn explore(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Done {
    let start = Instant::now();
    let mut search = Search {
        phase,
        course: Course::new(plan, faults),
        seen: HashSet::default(),
        origins: Vec::new(),
        queue: VecDeque::new(),
        reached: Vec::new(),
        hits: Vec::new(),
        moves: 0,
        longest: 0,
        outgrown: false,
    };
    search.reached = nothing_reached(&search.course);
    let ended_by = search.run(start);
    let outgrown = || search.outgrown.then(|| "states that outgrow their packed form".to_string());
    let ended_by = ended_by.or_else(outgrown);
    let mattered = search.course.mattered.clone();
    let findings: Vec<Finding> = search.hits.iter().map(|hit| search.tell(plan, faults, hit)).collect();
    let coverage = Coverage {
        phase,
        states: search.seen.len() as u64,
        moves: search.moves,
        depth: search.origins.iter().map(|origin| u64::from(origin.depth)).max().unwrap_or(0),
        ticks: findings.iter().map(|finding| finding.at_ticks).max().unwrap_or(0),
        complete: ended_by.is_none(),
        ended_by,
        longest_state: search.longest as u64,
        seconds: start.elapsed().as_secs_f64(),
    };
    let pruned = search.hits.iter().any(|hit| hit.shown.last);
    Done { coverage, findings, reached: search.reached, mattered, pruned }
}

impl Search {
    /// Says which budget ended it.
    fn run(&mut self, start: Instant) -> Option<String> {
        let budget = self.course.plan.budget;
        let root = Origin { parent: u32::MAX, choice: 0, depth: 0 };
        self.walk(root, None);
        let mut looked = 0_u64;
        let (mut all, mut moves) = (Vec::new(), Vec::new());
        while let Some((at, state)) = self.queue.pop_front() {
            looked += 1;
            if looked.is_multiple_of(LOOK) {
                if start.elapsed().as_secs_f64() > budget.seconds {
                    return Some(format!("{} seconds", budget.seconds));
                }
                if resident_bytes().is_some_and(|bytes| bytes > budget.bytes) {
                    return Some(format!("{} bytes of memory", budget.bytes));
                }
            }
            if self.seen.len() as u64 >= budget.states {
                return Some(format!("{} states", budget.states));
            }
            self.course.load(&state);
            all.clear();
            moves.clear();
            self.course.moves(&mut all);
            moves.extend((0_u16..).zip(all.iter().copied()));
            if self.leave_out(&state, &mut moves) {
                self.course.load(&state);
            }
            let depth = self.origins[at as usize].depth.saturating_add(1);
            for (i, &(choice, step)) in moves.iter().enumerate() {
                if i > 0 {
                    self.course.load(&state);
                }
                self.walk(Origin { parent: at, choice, depth }, Some(step));
            }
        }
        None
    }

    /// Leaves out what takes a packet away that changes nothing where it arrives: the same happens when it arrives, with
    /// more of the budget left, and a cut may as well begin with the next packet, or end before it. Says whether the
    /// course was used.
    fn leave_out(&mut self, state: &[u8], moves: &mut Vec<(u16, CellMove)>) -> bool {
        if self.course.plan.everything {
            return false;
        }
        let mut taken: Vec<u8> = moves.iter().filter_map(|&(_, step)| takes_away(step)).collect();
        taken.dedup();
        for &i in &taken {
            let comes = |&&(_, step): &&(u16, CellMove)| matches!(step, CellMove::Deliver(at) | CellMove::Mend(at, _) if at == i);
            let Some(&(_, arrives)) = moves.iter().find(comes) else { continue };
            let course = &mut self.course;
            let with = catch_unwind(AssertUnwindSafe(|| course.after(state, arrives)));
            let without = course.without(state, i);
            if !matches!(with, Ok(Some(with)) if with == without) {
                continue;
            }
            let cut = moves.iter().any(|&(_, step)| step == CellMove::Vanish(i));
            moves.retain(|&(_, step)| match step {
                CellMove::Lose(at) | CellMove::Cut(at, _) => at != i,
                CellMove::Mend(at, _) => at != i || !cut,
                _ => true,
            });
        }
        !taken.is_empty()
    }

    /// Makes a move, goes on while there is only one, and keeps where that leads.
    fn walk(&mut self, origin: Origin, first: Option<CellMove>) {
        let mut step = first;
        let mut moves = Vec::new();
        for steps in 1..=WALK {
            if let Some(step) = step {
                self.moves += 1;
                let course = &mut self.course;
                if catch_unwind(AssertUnwindSafe(|| course.apply(step))).is_err() {
                    self.course = Course::new(&Arc::clone(&self.course.plan), &self.course.faults.clone());
                    self.course.floor.violation = Some(Violation::Panic);
                }
            }
            if self.look(origin, steps) {
                return;
            }
            moves.clear();
            self.course.moves(&mut moves);
            if !moves.iter().any(|step| !matches!(step, CellMove::Crash(_) | CellMove::Restart(_))) {
                if let Some(shown) = deadlock(&self.course) {
                    self.note(shown, origin, steps);
                }
                if moves.is_empty() {
                    return;
                }
            }
            match moves[..] {
                [only] if steps < WALK => step = Some(only),
                _ => break,
            }
        }
        match self.course.store() {
            Ok(state) => self.keep(origin, state),
            // As when members of a meeting give up by themselves for ever: their rounds differ more and more.
            Err(Violation::Overflow) => self.outgrown = true,
            Err(violation) => {
                let cause = violation.text().to_string();
                let (kind, task, address, check) = (Kind::Machine, None, None, None);
                self.note(Shown { kind, task, address, check, cause, last: true }, origin, WALK);
            }
        }
    }

    /// Notes what the last move showed; whether nothing that follows is looked at.
    fn look(&mut self, origin: Origin, steps: usize) -> bool {
        let shown = judge(&mut self.course, self.phase, &mut self.reached);
        let last = shown.iter().any(|shown| shown.last);
        shown.into_iter().for_each(|shown| self.note(shown, origin, steps));
        last
    }

    fn note(&mut self, shown: Shown, origin: Origin, steps: usize) {
        let same = |hit: &Hit| {
            let old = &hit.shown;
            (old.kind, old.task, old.address, old.check)
                == (shown.kind, shown.task, shown.address, shown.check)
        };
        if !self.hits.iter().any(same) {
            self.hits.push(Hit { shown, origin, steps });
        }
    }

    fn keep(&mut self, origin: Origin, state: Box<[u8]>) {
        let mut hasher = DefaultHasher::new();
        state.hash(&mut hasher);
        if !self.seen.insert(hasher.finish()) {
            return;
        }
        self.longest = self.longest.max(state.len());
        let Ok(at) = u32::try_from(self.origins.len()) else { return };
        self.origins.push(origin);
        self.queue.push_back((at, state));
    }

    /// The moves to a hit, walked through ones included.
    fn path(&self, plan: &Arc<CellPlan>, faults: &CellFaults, hit: &Hit) -> Vec<CellMove> {
        let mut choices = Vec::new();
        let mut origin = hit.origin;
        while origin.parent != u32::MAX {
            choices.push(usize::from(origin.choice));
            origin = self.origins[origin.parent as usize];
        }
        choices.reverse();
        let mut course = Course::new(plan, faults);
        let mut path = Vec::new();
        let mut moves = Vec::new();
        // The walk before the first choice has one move less: it begins with none.
        let mut walk = |course: &mut Course, first: Option<usize>, most: usize| {
            let mut choice = first;
            for steps in 1..=most {
                if steps > 1 || choice.is_some() {
                    moves.clear();
                    course.moves(&mut moves);
                    let alone = choice.is_none() && moves.len() != 1;
                    let Some(&step) = moves.get(choice.take().unwrap_or(0)).filter(|_| !alone) else {
                        return;
                    };
                    path.push(step);
                    if catch_unwind(AssertUnwindSafe(|| course.apply(step))).is_err() {
                        return;
                    }
                }
            }
        };
        let last = choices.len();
        walk(&mut course, None, if last == 0 { hit.steps } else { WALK });
        for (i, choice) in choices.into_iter().enumerate() {
            walk(&mut course, Some(choice), if i + 1 == last { hit.steps } else { WALK });
        }
        path
    }

    fn tell(&self, plan: &Arc<CellPlan>, faults: &CellFaults, hit: &Hit) -> Finding {
        let moves = self.path(plan, faults, hit);
        let told = story::tell(plan, faults, &moves, &hit.shown.cause);
        let Shown { kind, task, address, check, ref cause, .. } = hit.shown;
        Finding {
            kind,
            phase: self.phase,
            task: task.map(TaskId::from_index),
            address,
            check,
            cause: cause.clone(),
            at_ticks: told.ticks,
            moves,
            steps: told.steps,
            chart: told.chart,
        }
    }
}

/// The packet that a move takes off its link without an arrival.
const fn takes_away(step: CellMove) -> Option<u8> {
    match step {
        CellMove::Lose(i) | CellMove::Cut(i, _) | CellMove::Vanish(i) => Some(i),
        CellMove::Pass
        | CellMove::Drift(..)
        | CellMove::Deliver(_)
        | CellMove::Duplicate(_)
        | CellMove::Mend(..)
        | CellMove::Acted(..)
        | CellMove::GoOn(..)
        | CellMove::Choose(..)
        | CellMove::Crash(_)
        | CellMove::Restart(_) => None,
    }
}

fn conclude(plan: &Arc<CellPlan>, done: Vec<Done>) -> Verdicts {
    // What nobody reached before a finding that ends its way may lie behind it.
    let complete = done.iter().all(|done| done.coverage.complete && !done.pruned);
    let mut verdicts = Verdicts::default();
    for (number, conduct) in plan.tasks.iter().enumerate() {
        let Conduct::Program { program, .. } = conduct else {
            verdicts.statements.push((0, 0));
            continue;
        };
        let is = |at: &usize| program.code[*at] == Op::Statement;
        let all: Vec<usize> = (0..program.code.len()).filter(is).collect();
        let missed = |at: &&usize| !done.iter().any(|done| done.reached[number][**at]);
        let missed: Vec<usize> = all.iter().filter(missed).copied().collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        verdicts.statements.push((count(all.len() - missed.len()), count(all.len())));
        let task = TaskId::from_index(number);
        let plain = judge::needs_no_fault(program);
        for at in missed {
            let needs_fault = !plain[at];
            let at = Address::try_from(at).unwrap_or(Address::MAX);
            if needs_fault && complete {
                verdicts.not_exercised.push((task, at));
            } else if complete {
                let cause = format!("{}: never reached", judge::name(&plan.table, number));
                verdicts.findings.push(bare(Kind::Unreached, Some((task, at)), None, cause));
            } else {
                verdicts.not_seen.push((task, at));
            }
        }
    }
    for (number, check) in plan.checks.iter().enumerate() {
        let leads = matches!(check.holds, Holds::Leads { .. });
        if complete && leads && !done.iter().any(|done| done.mattered[number]) {
            let cause = format!("`{}`: what should lead somewhere never happens", check.name);
            verdicts.findings.push(bare(Kind::Vacuous, None, Some(number), cause));
        }
    }
    for done in done {
        verdicts.phases.push(done.coverage);
        for finding in done.findings {
            let key = |f: &Finding| (f.kind, f.task, f.address, f.check);
            if !verdicts.findings.iter().any(|other| key(other) == key(&finding)) {
                verdicts.findings.push(finding);
            }
        }
    }
    verdicts.findings.sort_by_key(|finding| (finding.kind, finding.phase, finding.task, finding.address));
    verdicts
}

fn bare(kind: Kind, place: Option<(TaskId, Address)>, check: Option<usize>, cause: String) -> Finding {
    Finding {
        kind,
        phase: Phase::FaultFree,
        task: place.map(|(task, _)| task),
        address: place.map(|(_, at)| at),
        check,
        cause,
        at_ticks: 0,
        moves: Vec::new(),
        steps: Vec::new(),
        chart: String::new(),
    }
}
