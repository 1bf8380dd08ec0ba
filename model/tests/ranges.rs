//! Tests the times with which a finding of the search by zones states that it happens.

use crate::cells::{Text, is_alike, within};
use crate::faulty_cells::faulty_in;
use crate::guard::{dice, number, random_cell, random_text};
use imrs_model::cell::{Finding, TimeRange, Timed, Times, Verdicts, compare_ranges_with_runs};
use std::sync::Arc;

fn checked(text: &str, times: Times) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    (cell.plan.times, cell.plan.budget) = (times, within(20_000));
    let verdicts = cell.check();
    (cell, verdicts)
}

/// The text with a fixed time of an action, in place of its interval.
fn fixed(text: &str, action: &str, ticks: u64) -> String {
    let begin = format!("run {action} takes ");
    let (before, after) = text.split_once(&begin).expect("the action");
    let (_, after) = after.split_once(" msec").expect("its times");
    format!("{before}{begin}{ticks} msec{after}")
}

/// Whether a cell has a finding if its only uncertain action takes a certain time.
fn is_found(text: &str, finding: &Finding, action: &str, ticks: u64) -> bool {
    let (_, verdicts) = checked(&fixed(text, action, ticks), Times::Every);
    assert!(verdicts.is_complete(), "{:?}", verdicts.phases);
    verdicts.findings.iter().any(|other| is_alike(other, finding))
}

#[test]
fn a_finding_with_one_uncertain_action_happens_at_exactly_the_times_that_it_states() {
    let (mut compared, mut narrowed) = (0, 0);
    for cell in faulty_in("../examples/faulty/inside") {
        let (_, verdicts) = checked(&cell.text, Times::Zones);
        for finding in &verdicts.findings {
            let [range] = &finding.ranges[..] else { continue };
            let Timed::Action { name, .. } = &range.timed else { continue };
            let TimeRange { least, most, declared_least, declared_most, .. } = *range;
            let (most, declared_most) = (most.expect("it ends"), declared_most.expect("it ends"));
            let is_in = |ticks: u64| (least..=most).contains(&ticks);
            // Behind a time that shows nothing, another fault may lead to the same finding.
            let ends = [least.checked_sub(1), most.checked_add(1)];
            let beyond =
                ends.into_iter().flatten().filter(|at| (declared_least..=declared_most).contains(at));
            for ticks in (least..=most).chain(beyond) {
                let found = is_found(&cell.text, finding, name, ticks);
                assert_eq!(found, is_in(ticks), "{}, {}: {name} takes {ticks}", cell.name, finding.cause);
            }
            compared += 1;
            narrowed += u32::from(range.is_narrowed());
        }
    }
    assert!(compared >= 5 && narrowed == compared, "{compared}, {narrowed} of them narrowed");
}

/// Searches a cell by zones, and makes runs within the ranges of each finding. Returns the numbers of findings with ranges, of narrowed
/// ranges and of runs.
fn runs_within(name: &str, mut cell: Text, draw: &mut dyn FnMut(usize) -> usize) -> [u64; 3] {
    cell.plan.times = Times::Zones;
    cell.plan.faults.retain(|faults| faults.pause.is_empty() && faults.drift == 0);
    let verdicts = cell.check();
    let plan = Arc::new(cell.plan.clone());
    let mut all = [0; 3];
    for finding in
        verdicts.findings.iter().filter(|finding| finding.part.is_none() && !finding.ranges.is_empty())
    {
        let runs = compare_ranges_with_runs(&plan, finding, 20, draw);
        let runs = runs.unwrap_or_else(|differs| panic!("{name}, {}: {differs}", finding.cause));
        assert!(runs > 0, "{name}: {}", finding.cause);
        let narrowed = finding.ranges.iter().filter(|range| range.is_narrowed()).count() as u64;
        all = [all[0] + 1, all[1] + narrowed, all[2] + runs];
    }
    all
}

#[test]
fn runs_at_times_within_the_ranges_of_a_finding_show_it() {
    let mut all = [0; 3];
    let mut add = |more: [u64; 3]| all.iter_mut().zip(more).for_each(|(all, more)| *all += more);
    for (seed, cell) in (1..).zip(faulty_in("../examples/faulty/inside")) {
        let mut dice = dice(seed);
        add(runs_within(&cell.name, Text::new(&cell.text), &mut |limit| dice.below(limit)));
    }
    let (cells, first) = (number("IMRS_CELLS", 40), number("IMRS_SEED", 1));
    for seed in first..first + cells {
        let Some(mut cell) = random_cell(seed) else { continue };
        cell.plan.budget = within(8_000);
        let mut dice = dice(seed);
        let name = format!("IMRS_SEED={seed} IMRS_CELLS=1\n{}", random_text(seed));
        add(runs_within(&name, cell, &mut |limit| dice.below(limit)));
    }
    let [findings, narrowed, runs] = all;
    println!("{findings} findings, {narrowed} narrowed ranges, {runs} runs");
    assert!(findings > cells / 5 && narrowed > cells / 5 && runs > 20 * findings, "{all:?}");
}
