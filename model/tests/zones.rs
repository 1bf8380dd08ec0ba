//! The search by zones against the search at every tick: both must find and reach the same.

use crate::cells::{Text, within};
use crate::guard::{number, random_cell};
use imrs_model::cell::{CellFaults, Finding, Kind, Times, Verdicts, check_cell};
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::path::Path;
use std::sync::Arc;

/// Most states of a search at every tick: larger ones are left out.
fn states() -> u64 {
    number("IMRS_STATES", 4_000)
}

/// Whether a finding is of tasks that wait for ever while others go on. The search at every tick looks for these in some states only,
/// which depend on what it keeps; zones look in all.
fn waits(found: &Finding) -> bool {
    matches!(found.kind, Kind::Deadlock | Kind::WaitsForEver)
}

/// The facts in which both searches must agree: the findings, and what was reached.
fn told(verdicts: &Verdicts, is_pruned: bool) -> Vec<String> {
    fn words(all: &[impl Debug]) -> impl Iterator<Item = String> {
        all.iter().map(|one| format!("{one:?}"))
    }
    // Behind a deadlock nothing is proved of statements that were not reached.
    let is_told = |found: &&Finding| !(waits(found) || is_pruned && found.kind == Kind::Unreached);
    let found = verdicts.findings.iter().filter(is_told).map(|found| {
        // Starvation is judged on one path only.
        let kind = if found.kind == Kind::Starves { Kind::TimeOut } else { found.kind };
        let phase = (found.phase, found.hypothesis);
        format!(
            "{kind:?} {phase:?} {:?} {:?} {:?} {:?}",
            found.task, found.address, found.check, found.couple
        )
    });
    let mut all: Vec<String> = found.collect();
    all.extend(words(&verdicts.statements));
    if !is_pruned {
        all.extend(words(&verdicts.not_exercised));
        all.extend(words(&verdicts.not_tried));
    }
    all.extend(words(&verdicts.still));
    all.sort();
    all
}

/// The tasks that wait for ever, and where.
fn waiting(verdicts: &Verdicts) -> BTreeSet<String> {
    let found = verdicts.findings.iter().chain(&verdicts.warnings).filter(|found| waits(found));
    found.map(|found| format!("{:?} at {:?}", found.task, found.address)).collect()
}

/// How many searches were compared, and their states.
#[derive(Debug, Default)]
struct Compared {
    cells: u64,
    phases: u64,
    findings: u64,
    every: u64,
    zones: u64,
}

/// Compares the verdicts of the search by zones and of the search at every tick; `None` if the latter takes
/// too many states.
fn compare(name: &str, cell: &mut Text, states: u64) -> Option<Compared> {
    cell.plan.faults.retain(covered);
    cell.plan.budget = within(states);
    cell.plan.times = Times::Every;
    let every = check_cell(&Arc::new(cell.plan.clone()));
    if !every.is_complete() {
        return None;
    }
    // The search by zones does not use some reductions of the other search, so it may take more states.
    cell.plan.budget = within(8 * states);
    cell.plan.times = Times::Zones;
    let zones = check_cell(&Arc::new(cell.plan.clone()));
    assert!(zones.is_complete(), "{name}: {:?} {:?}", zones.refused, zones.phases);
    let (more, fewer) = (waiting(&zones), waiting(&every));
    assert!(more.is_superset(&fewer), "{name}: only {more:?} by zones, {fewer:?} at every tick");
    let is_pruned = more != fewer;
    assert_eq!(told(&zones, is_pruned), told(&every, is_pruned), "{name}, by zones and at every tick");
    let all = |verdicts: &Verdicts| verdicts.phases.iter().map(|phase| phase.states).sum();
    let (phases, findings) = (zones.phases.len() as u64, zones.findings.len() as u64);
    Some(Compared { cells: 1, phases, findings, every: all(&every), zones: all(&zones) })
}

fn covered(faults: &CellFaults) -> bool {
    faults.pause.is_empty() && faults.drift == 0 && faults.crash.is_empty()
}

#[test]
fn random_cells_are_found_the_same_by_zones() {
    let (cells, first) = (number("IMRS_CELLS", 400), number("IMRS_SEED", 1));
    let mut all = Compared::default();
    for seed in first..first + cells {
        let Some(mut cell) = random_cell(seed) else { continue };
        let name = format!("IMRS_SEED={seed} IMRS_CELLS=1");
        let Some(one) = compare(&name, &mut cell, states()) else { continue };
        all.cells += 1;
        all.phases += one.phases;
        all.findings += one.findings;
        all.every += one.every;
        all.zones += one.zones;
    }
    println!("{all:?}");
    assert!(all.cells * 2 > cells && all.findings > cells, "{all:?}");
}

#[test]
fn examples_are_found_the_same_by_zones() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let mut compared = 0;
    for entry in std::fs::read_dir(folder).expect("the examples") {
        let path = entry.expect("an entry").path();
        if path.extension().is_none_or(|extension| extension != "cell") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a cell");
        let one = compare(&path.display().to_string(), &mut Text::new(&text), 5 * states());
        println!("{}: {one:?}", path.display());
        compared += u64::from(one.is_some());
    }
    assert!(compared > 0, "no example is small enough");
}
