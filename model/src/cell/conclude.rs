//! Joins the results of all searches to the verdict on a cell.

use super::done::Done;
use super::judge::{self, Reached};
use super::missed::Missed;
use super::plan::{CellFaults, CellPlan, Holds, Times};
use super::run_state::RunState;
use super::values::Tried;
use super::verdict::{Finding, Kind, Phase, Verdicts};
use super::zones::ranges;
use super::{alike, context};
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, Term};
use std::sync::Arc;

/// Joins the results of the phases. `is_open`: more may be possible than was tried, because tasks outside the cell may use
/// their ports at other times or with other values, or actions may give other results.
pub(super) fn conclude(plan: &Arc<CellPlan>, done: Vec<Done>, (outside, is_open): (Tried, bool)) -> Verdicts {
    // A finding that ends a path may hide what comes after it. If there was one, no statement counts as unreachable.
    let complete = done.iter().all(|done| done.coverage.complete && !done.coverage.pruned);
    let mut verdicts = Verdicts { outside, ..Verdicts::default() };
    let missed = plan.tasks.iter().enumerate().map(|(number, conduct)| {
        Missed::of(conduct, |at| done.iter().any(|done| done.reached.statements[number][at]))
    });
    let missed: Vec<Missed> = missed.collect();
    // A statement that needs a fault may store or send something that leads any task to statements which need
    // no fault of their own.
    let leads_on = missed.iter().any(|missed| missed.leads_on);
    for (number, missed) in missed.into_iter().enumerate() {
        verdicts.statements.push(missed.counts);
        let task = TaskId::from_index(number);
        for (at, needs_fault) in missed.statements {
            let at = Address::try_from(at).unwrap_or(Address::MAX);
            if (needs_fault || leads_on) && complete {
                verdicts.not_exercised.push((task, at));
            } else if complete && is_open {
                verdicts.not_tried.push((task, at));
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
        if complete && leads && !is_open && !done.iter().any(|done| done.mattered[number]) {
            let cause = format!("`{}`: what should lead somewhere never happens", check.name);
            verdicts.findings.push(bare(Kind::Vacuous, None, Some(number), cause));
        }
    }
    verdicts.still = still(plan, &done);
    let place = |found: &Finding| (found.task, found.address);
    for done in done {
        verdicts.phases.push(done.coverage);
        // If a warning is for the same task and statement as one of an earlier phase (search), it is not reported
        // again.
        let is_known = |new: &Finding| verdicts.warnings.iter().any(|known| place(known) == place(new));
        let new: Vec<Finding> = done.warnings.into_iter().filter(|new| !is_known(new)).collect();
        verdicts.warnings.extend(new);
        for finding in done.findings {
            if !verdicts.findings.iter().any(|other| is_the_same(other, &finding)) {
                verdicts.findings.push(finding);
            }
        }
    }
    // If a task waits for ever at the place of a deadlock, the wait is part of that deadlock.
    let deadlocks: Vec<_> = verdicts.of(Kind::Deadlock).map(place).collect();
    verdicts.warnings.retain(|warning| !deadlocks.contains(&place(warning)));
    verdicts.findings.sort_by_key(|finding| (finding.kind, finding.phase, finding.task, finding.address));
    verdicts.findings = alike::told_once(plan, std::mem::take(&mut verdicts.findings));
    for finding in verdicts.findings.iter_mut().chain(&mut verdicts.warnings) {
        finding.ranges = ranges(plan, finding);
    }
    verdicts
}

/// Whether two findings are about the same place in the cell, whatever moves lead to them.
fn is_the_same(one: &Finding, other: &Finding) -> bool {
    let key =
        |finding: &Finding| (finding.kind, finding.task, finding.address, finding.check, finding.couple);
    key(one) == key(other) && (one.kind != Kind::Machine || one.cause == other.cause)
}

/// The terms of checks that never changed in any state of any phase, as text: `r2.active = false`.
fn still(plan: &Arc<CellPlan>, done: &[Done]) -> Vec<(usize, String)> {
    let start = RunState::new(plan, &CellFaults::default());
    let all = done.iter().map(|done| done.reached.clone()).reduce(Reached::join).unwrap_or_default();
    let checks = all.still.into_iter().enumerate();
    let said = |(check, terms): (usize, Vec<(Term, Option<i64>)>)| {
        let start = &start;
        terms.into_iter().filter_map(move |(term, _)| Some((check, context::value(start, term)?)))
    };
    checks.flat_map(said).collect()
}

fn bare(kind: Kind, place: Option<(TaskId, Address)>, check: Option<usize>, cause: String) -> Finding {
    Finding {
        kind,
        phase: Phase::FaultFree,
        hypothesis: 0,
        times: Times::Ends,
        part: None,
        task: place.map(|(task, _)| task),
        also: Vec::new(),
        address: place.map(|(_, at)| at),
        check,
        couple: None,
        others: Vec::new(),
        cause,
        at_ticks: 0,
        ranges: Vec::new(),
        moves: Vec::new(),
        steps: Vec::new(),
        chart: String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::judge::Shown;
    use crate::state::Violation;

    #[test]
    fn two_couples_with_two_owners_are_two_findings() {
        let of =
            |couple| Finding { couple: Some(couple), ..bare(Kind::TwoOwners, None, None, "both act".into()) };
        assert!(is_the_same(&of(1), &of(1)));
        assert!(!is_the_same(&of(0), &of(1)));
    }

    #[test]
    fn two_violations_of_the_machine_are_two_findings() {
        let [stale, panic] = [Violation::Stale, Violation::Panic].map(Violation::text);
        let shown = |cause| Shown::whole(Kind::Machine, cause);
        assert!(shown(stale).is_same(&shown(stale)) && !shown(stale).is_same(&shown(panic)));
        let found = |cause: &str| bare(Kind::Machine, None, None, cause.into());
        assert!(is_the_same(&found(stale), &found(stale)) && !is_the_same(&found(stale), &found(panic)));
    }
}
