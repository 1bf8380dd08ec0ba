//! Chooses the searches that check a cell, and joins their results.

use super::conclude::conclude;
use super::done::Done;
use super::each_part::look_at_each;
use super::outside::{tried, with_programs};
use super::parts::parts;
use super::plan::{CellFaults, CellPlan, Conduct, Times};
use super::progress::SearchProgress;
use super::verdict::{Phase, Refused, Verdicts};
use super::{judge, search, zones};
use crate::Silent;
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, Op};
use std::sync::Arc;
use std::time::Instant;

/// Checks a cell: first without faults, which finds what goes wrong by itself, then within each hypothesis of faults.
#[must_use]
pub fn check_cell(plan: &Arc<CellPlan>) -> Verdicts {
    check_cell_and_tell(plan, &Silent)
}

/// As [`check_cell`], and also reports to `progress` how far the searches are.
#[must_use]
pub fn check_cell_and_tell(plan: &Arc<CellPlan>, progress: &dyn SearchProgress) -> Verdicts {
    let outside = tried(plan);
    let is_open = plan.has_extern() || plan.has_open_results();
    let plan = &with_programs(plan);
    if let Some(refused) = refused(plan) {
        return Verdicts { refused: Some(refused), ..Verdicts::default() };
    }
    let (parts, none) = (parts(plan), CellFaults::default());
    let without_faults = |plan: &Arc<CellPlan>| look(plan, (Phase::FaultFree, 0), &none, progress);
    let mut done = vec![look_at_each(plan, &parts, &none, None, without_faults)];
    progress.finished(&done[0].coverage);
    for (hypothesis, faults) in plan.faults.iter().enumerate().filter(|(_, faults)| !faults.are_none()) {
        let search = |plan: &Arc<CellPlan>| look(plan, (Phase::Faults, hypothesis), faults, progress);
        let next = look_at_each(plan, &parts, faults, Some(&done[0]), search);
        progress.finished(&next.coverage);
        done.push(next);
    }
    conclude(plan, done, (outside, is_open))
}

/// Searches a phase at the event times of the plan.
fn look(
    plan: &Arc<CellPlan>,
    phase: (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
) -> Done {
    // If each action and packet can take only one time, the coarse times are all times. But a pause may end at any time.
    let is_exact = plan.times == Times::Auto && plan.is_exact() && faults.pause.is_empty();
    if plan.times == Times::Auto && !is_exact {
        return look_at_all_times(plan, phase, faults, progress);
    }
    let plan = &if is_exact { plan.timed(Times::Ends) } else { Arc::clone(plan) };
    let mut done = explore(plan, phase, faults, progress, true);
    if is_exact {
        done.coverage.times = Times::Every;
    }
    done
}

/// Searches at all times if that ends within the budget, and else at the ends of times ([`Times::Auto`]).
fn look_at_all_times(
    plan: &Arc<CellPlan>,
    phase: (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
) -> Done {
    let start = Instant::now();
    // A copy of the plan with other event times, whose search ends when this share of the plan's seconds has passed.
    let within = |times: Times, share: f64| {
        let mut short = CellPlan { times, ..CellPlan::clone(plan) };
        short.budget.seconds = (plan.budget.seconds * share - start.elapsed().as_secs_f64()).max(0.0);
        if times != Times::Zones && share < 1.0 {
            let most = if faults.are_none() { Times::AUTO_STATES } else { Times::AUTO_STATES_WITH_FAULTS };
            short.budget.states = short.budget.states.min(most);
        }
        Arc::new(short)
    };
    let attempts: &[(Times, f64)] = match zones::uncovered(plan, faults) {
        None if plan.step == 1 => &[(Times::Every, 0.125), (Times::Zones, 0.75)],
        None => &[(Times::Zones, 0.75)],
        Some(_) => &[(Times::Every, 0.25), (Times::Between, 0.5)],
    };
    let mut tried: Option<Done> = None;
    for &(times, share) in attempts {
        let mut done = explore(&within(times, share), phase, faults, progress, false).with(tried);
        if done.coverage.complete {
            if !done.findings.is_empty() {
                // Findings of the coarse times (`Times::Ends`) are reported first: their schedules use declared times,
                // which are rounder numbers.
                let short = within(Times::Ends, 0.9);
                done.findings.splice(0..0, explore(&short, phase, faults, progress, false).findings);
            }
            return done;
        }
        tried = Some(done);
    }
    let last = within(Times::Ends, 1.0);
    let mut done = explore(&last, phase, faults, progress, true).with(tried);
    if done.coverage.ended_by == Some(last.budget.out_of_time()) {
        done.coverage.ended_by = Some(plan.budget.out_of_time());
    }
    done
}

/// Searches once, by zones or at plain ticks. `says_what_is_large`: also finds out what makes the search large if a budget
/// ends it, which takes time.
fn explore(
    plan: &Arc<CellPlan>,
    phase: (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
    says_what_is_large: bool,
) -> Done {
    match plan.times {
        Times::Zones => zones::explore(plan, phase, faults, progress),
        _ => search::explore(plan, phase, faults, progress, says_what_is_large),
    }
}

/// Most nodes, links and tasks in one search: a bit for each node and each direction of a link, a byte for a task.
const MOST: (usize, usize, usize) = (64, 255, 32);

/// Refuses a cell that is too large, or whose programs store message numbers, which no canonical state can hold (D51).
fn refused(plan: &CellPlan) -> Option<Refused> {
    let names = |task: &Conduct| match task {
        Conduct::Program { program, .. } => program.code.iter().position(|op| *op == Op::ReceivedId),
        Conduct::Extern(_) => None,
    };
    let keeps = || {
        let (task, at) = plan.tasks.iter().enumerate().find_map(|(i, task)| Some((i, names(task)?)))?;
        let name = judge::name(&plan.table, task);
        let why = format!("{name} keeps the number of a message, which the checker cannot follow");
        let at = Address::try_from(at).unwrap_or(Address::MAX);
        Some(Refused { task: TaskId::from_index(task), at, why })
    };
    too_large(plan).or_else(|| not_by_zones(plan)).or_else(keeps)
}

/// Refuses a plan that the search by zones does not cover, rather than covering less of it.
fn not_by_zones(plan: &CellPlan) -> Option<Refused> {
    if plan.times != Times::Zones {
        return None;
    }
    let none = CellFaults::default();
    let what =
        std::iter::once(&none).chain(&plan.faults).find_map(|faults| zones::uncovered(plan, faults))?;
    let why = format!("zones do not cover {what} yet; use --times every");
    Some(Refused { task: TaskId::from_index(0), at: 0, why })
}

/// Refuses a cell with more nodes, tasks or links than moves can number.
pub(super) fn too_large(plan: &CellPlan) -> Option<Refused> {
    let cell = plan.table.cell();
    let (nodes, tasks, links) = MOST;
    if cell.nodes.len() <= nodes && cell.tasks.len() <= tasks && cell.links.len() <= links {
        return None;
    }
    let why = format!(
        "{} nodes, {} tasks and {} links are more than the checker takes: at most {nodes}, {tasks} and {links}",
        cell.nodes.len(),
        cell.tasks.len(),
        cell.links.len()
    );
    Some(Refused { task: TaskId::from_index(0), at: 0, why })
}
