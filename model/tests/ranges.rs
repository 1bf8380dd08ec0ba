//! Tests the ranges of a finding: for which times of its actions and packets the finding occurs.

use crate::cells::{Text, is_alike, within};
use crate::faulty_cells::faulty_in;
use crate::guard::{dice, number, random_cell, random_text};
use imrs_model::cell::{Finding, Kind, TimeRange, Timed, Times, Verdicts, compare_ranges_with_runs};
use std::sync::Arc;

const POLLED: &str = include_str!("../../examples/faulty/robots_poll_for_each_others_zone.cell");

/// The times with which cells are searched. `Auto` searches small cells at every tick, and cells with findings also at
/// the ends of times.
const TIMES: [Times; 2] = [Times::Zones, Times::Auto];

fn checked(text: &str, times: Times) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    (cell.plan.times, cell.plan.budget) = (times, within(20_000));
    let verdicts = cell.check();
    (cell, verdicts)
}

/// The cell's text, in which an action takes a fixed time in place of its interval.
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
    told(&verdicts).any(|other| is_alike(other, finding))
}

fn told(verdicts: &Verdicts) -> impl Iterator<Item = &Finding> {
    verdicts.findings.iter().chain(&verdicts.warnings)
}

/// If only one action of a finding has an uncertain time: compares its range with searches in which the action takes a
/// fixed time. These are the times of the range, and one tick beyond either end. Returns whether the range is narrower
/// than the declared one; `None` if the finding has no such range.
fn compare_with_fixed_times(name: &str, text: &str, finding: &Finding) -> Option<bool> {
    let [range] = &finding.ranges[..] else { return None };
    let Timed::Action { name: action, .. } = &range.timed else { return None };
    let TimeRange { least, most, declared_least, declared_most, .. } = *range;
    let (most, declared_most) = (most?, declared_most?);
    let ends = [least.checked_sub(1), most.checked_add(1)];
    let beyond = ends.into_iter().flatten().filter(|at| (declared_least..=declared_most).contains(at));
    for ticks in (least..=most).chain(beyond) {
        let found = is_found(text, finding, action, ticks);
        let is_in = (least..=most).contains(&ticks);
        assert_eq!(found, is_in, "{name}, {}: {action} takes {ticks}", finding.cause);
    }
    Some(range.is_narrowed())
}

#[test]
fn a_finding_with_one_uncertain_action_happens_at_exactly_the_times_that_it_states() {
    let (mut compared, mut narrowed) = (0, 0);
    for cell in faulty_in("../examples/faulty/inside") {
        for times in [Times::Zones, Times::Every] {
            let (_, verdicts) = checked(&cell.text, times);
            for finding in told(&verdicts) {
                let name = format!("{}, {times:?}", cell.name);
                let Some(is_narrowed) = compare_with_fixed_times(&name, &cell.text, finding) else {
                    continue;
                };
                compared += 1;
                narrowed += u32::from(is_narrowed);
            }
        }
    }
    println!("{compared} compared, {narrowed} of them narrowed");
    assert!(compared >= 10 && narrowed == compared, "{compared}, {narrowed} of them narrowed");
}

#[test]
fn a_standstill_happens_at_exactly_the_times_that_it_states() {
    // Only one of the two actions before the standstill takes an uncertain time. Each task runs its loop once: in a
    // second iteration, the robots could meet at other times.
    let once = POLLED.replace("  loop\n", "  while round < 1 do\n    round := round + 1;\n");
    let once = once.replace("  var zone: int8;\n", "  var zone: int8;\n  var round: int8;\n");
    let text = once.replacen("run come takes 0..40 msec", "run come takes 10..60 msec", 1);
    let text = text.replacen("run come takes 0..40 msec", "run come takes 20 msec", 1);
    for times in [Times::Zones, Times::Every] {
        let (_, verdicts) = checked(&text, times);
        let [warning] = &verdicts.warnings[..] else { panic!("{times:?}: {:?}", verdicts.warnings.len()) };
        println!("{times:?}: {:?}", warning.ranges);
        assert_eq!((warning.kind, warning.ranges.len()), (Kind::Standstill, 1), "{times:?}");
        let narrowed = compare_with_fixed_times(&format!("{times:?}"), &text, warning);
        assert_eq!(narrowed, Some(true), "{times:?}: {:?}", warning.ranges);
    }
}

/// Searches a cell, and makes runs within the ranges of each finding. Returns the numbers of findings with ranges, of standstills among
/// them, of narrowed ranges and of runs.
fn runs_within(
    name: &str,
    (cell, times): (&mut Text, Times),
    draw: &mut dyn FnMut(usize) -> usize,
) -> [u64; 4] {
    cell.plan.times = times;
    cell.plan.faults.retain(|faults| faults.pause.is_empty() && faults.drift == 0);
    let verdicts = cell.check();
    let plan = Arc::new(cell.plan.clone());
    let mut all = [0; 4];
    for finding in told(&verdicts).filter(|finding| !finding.ranges.is_empty()) {
        let runs = compare_ranges_with_runs(&plan, finding, 20, draw);
        let runs = runs.unwrap_or_else(|differs| panic!("{name}, {times:?}, {}: {differs}", finding.cause));
        assert!(runs > 0, "{name}: {}", finding.cause);
        let narrowed = finding.ranges.iter().filter(|range| range.is_narrowed()).count() as u64;
        let stands = u64::from(finding.kind == Kind::Standstill);
        all = [all[0] + 1, all[1] + stands, all[2] + narrowed, all[3] + runs];
    }
    all
}

#[test]
fn runs_at_times_within_the_ranges_of_a_finding_show_it() {
    let mut all = [0; 4];
    let mut add = |more: [u64; 4]| all.iter_mut().zip(more).for_each(|(all, more)| *all += more);
    let inside = faulty_in("../examples/faulty/inside").into_iter().map(|cell| (cell.name, cell.text));
    for (seed, (name, text)) in (1..).zip(inside.chain([("polled".into(), POLLED.into())])) {
        for times in TIMES {
            let (mut cell, mut dice) = (Text::new(&text), dice(seed));
            cell.plan.budget = within(20_000);
            add(runs_within(&name, (&mut cell, times), &mut |limit| dice.below(limit)));
        }
    }
    let (cells, first) = (number("IMRS_CELLS", 40), number("IMRS_SEED", 1));
    for seed in first..first + cells {
        let Some(mut cell) = random_cell(seed) else { continue };
        cell.plan.budget = within(8_000);
        let mut dice = dice(seed);
        let name = format!("IMRS_SEED={seed} IMRS_CELLS=1\n{}", random_text(seed));
        for times in TIMES {
            add(runs_within(&name, (&mut cell, times), &mut |limit| dice.below(limit)));
        }
    }
    let [findings, stands, narrowed, runs] = all;
    println!("{findings} findings, {stands} standstills, {narrowed} narrowed ranges, {runs} runs");
    assert!(findings > cells && narrowed > cells && runs > 20 * findings && stands > 1, "{all:?}");
}
