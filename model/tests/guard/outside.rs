//! Tests of extern tasks, whose bodies are outside the cell: the verdicts of the search must hold whatever such a body does.

use super::cells::{cell, filled};
use super::{Text, is_sound, within};
use imrs_model::cell::{Disagreement, Kind, Times, Verdicts};
use imrs_protocol::TaskId;
use imrs_protocol::script::Address;
use std::collections::BTreeSet;

/// The cell with branches added behind each statement that gives a task values. So its tasks distinguish all values that an
/// extern task may send.
fn with_telling_tasks(text: &str) -> String {
    let tells = ["i = 1", "j = 1", "m.n = 1", "m.b", "f"];
    let tells: String =
        tells.iter().map(|told| format!("    if {told} then run tell takes 1 msec; end;\n")).collect();
    let mut telling = String::new();
    for line in text.lines() {
        telling.push_str(line);
        telling.push('\n');
        let brings = line.starts_with("    receive")
            || [" -> i", " -> m", " -> f", "i := hu mod 3"].iter().any(|way| line.contains(way));
        if brings && line.ends_with(';') {
            telling.push_str(&tells);
        }
    }
    telling
}

/// The cell with bodies for its extern tasks, but with the checks of the cell without bodies, because only these read no
/// variables of the bodies.
fn with_checks_of(text: &str, with_bodies: &str) -> String {
    let is_check = |line: &&str| line.starts_with("check ");
    let bodies = with_bodies.lines().filter(|line| !is_check(line));
    bodies.chain(text.lines().filter(is_check)).fold(String::new(), |all, line| all + line + "\n")
}

/// Searches a cell that has an extern task, and then the same cell with a body for that task. Everything that the second
/// search shows about other tasks, the first search must show, too. Returns how many cells were compared.
///
/// # Errors
/// [`Disagreement`]: something that the first search does not show.
pub fn covers(tape: &[u8], bodies: &[u8], states: u64) -> Result<u32, Disagreement> {
    let Some((with_bodies, outside)) = filled(tape, bodies) else { return Ok(0) };
    let (text, with_bodies) = (with_telling_tasks(&cell(tape)), with_telling_tasks(&with_bodies));
    let with_bodies = with_checks_of(&text, &with_bodies);
    if !is_sound(&text) || !is_sound(&with_bodies) {
        return Ok(0);
    }
    let check = |mut cell: Text| {
        (cell.plan.times, cell.plan.budget) = (Times::Ends, within(states));
        cell.check()
    };
    let mut own = Text::new(&text);
    own.plan.budget = within(states);
    if own.is_too_large_without_faults() {
        return Ok(0);
    }
    let said = check(own);
    // If no extern task sends a value, or the first search is incomplete, there is nothing to compare.
    if !said.is_complete() || said.outside.is_empty() {
        return Ok(0);
    }
    let shown = check(Text::new(&with_bodies));
    let others = |task: TaskId| !outside.contains(&task.index());
    let wrong =
        |what: String| Disagreement { what: format!("{what}, with\n{with_bodies}"), moves: Vec::new() };
    let kinds = [Kind::Assertion, Kind::ScriptFault, Kind::Check, Kind::TwoOwners];
    for finding in shown.findings.iter().filter(|finding| kinds.contains(&finding.kind)) {
        let is = |(kind, task, address, check)| {
            (kind, task, address, check) == (finding.kind, finding.task, finding.address, finding.check)
        };
        let known = said.findings.iter().any(|f| is((f.kind, f.task, f.address, f.check)));
        if finding.task.is_none_or(others) && !known {
            return Err(wrong(format!("a task outside brings about what is not found: {}", finding.cause)));
        }
    }
    if shown.is_complete() {
        let unreached = not_reached(&shown);
        let missed = not_reached(&said).into_iter().find(|at| others(at.0) && !unreached.contains(at));
        if let Some((task, address)) = missed {
            return Err(wrong(format!("a task outside lets {task:?} reach {address}, which is not reached")));
        }
    }
    Ok(1)
}

/// The statements that the search did not reach, whatever reason the verdicts give for that.
fn not_reached(verdicts: &Verdicts) -> BTreeSet<(TaskId, Address)> {
    let unreached = verdicts.of(Kind::Unreached).filter_map(|finding| finding.task.zip(finding.address));
    let others = [&verdicts.not_exercised, &verdicts.not_tried, &verdicts.not_seen];
    unreached.chain(others.into_iter().flatten().copied()).collect()
}

/// Tries seeds until enough cells were compared, so that each run of the test compares some.
#[test]
fn whatever_a_task_outside_does_the_search_has_seen() {
    let (mut compared, mut seed) = (0, super::number("IMRS_SEED", 1));
    while compared < super::number("IMRS_OUTSIDE", 10) {
        let bodies = super::tape(seed + super::BODIES);
        match covers(&super::tape(seed), &bodies, super::states()) {
            Ok(one) => compared += u64::from(one),
            Err(how) => panic!("IMRS_SEED={seed} differs: {how}\n{}", cell(&super::tape(seed))),
        }
        seed += 1;
    }
}
