//! Tests of the cells in `examples/faulty`, each with one fault that shows only when the cell runs. The checker must find
//! that fault at the place that the file states, and nothing else. If the wrong lines are corrected, it must find nothing.
//!
//! The first lines of such a file are comments:
//! ```text
//! (* finds: W302 10:102 *)                               where there are warnings, what `imrs check` says
//! (* verify finds: "deadlock" 16:5 "cause", .. *)        kind, line:column, cause if it matters
//! (* what the engineer got wrong *)
//! (* right: 29: receive next(); reply(); *)              what line 29 should be; as many as it takes
//! ```

use crate::cells::{Text, is_alike, within};
use crate::guard::number;
use imrs_model::cell::{
    CellFaults, Finding, Kind, Note, Phase, Simulator, Verdicts, check_cell, drawn, scenes, svg,
};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, LazyLock};

/// The least number of faulty cells. Fewer would say too little about the checker.
const FEWEST: usize = 25;

/// Every kind of finding except `Kind::Machine`: no known cell makes the state machine itself fail.
const KINDS: [Kind; 16] = [
    Kind::Deadlock,
    Kind::TimeOut,
    Kind::Starves,
    Kind::Stranded,
    Kind::Refused,
    Kind::Ends,
    Kind::Aborts,
    Kind::Assertion,
    Kind::ScriptFault,
    Kind::Check,
    Kind::TwoOwners,
    Kind::Unreached,
    Kind::Vacuous,
    Kind::Standstill,
    Kind::WaitsForEver,
    Kind::LeaseLost,
];

/// The word in a file whose cell the checker cannot search.
const NOT_CHECKED: &str = "\"not checked\"";

pub struct Faulty {
    pub name: String,
    pub text: String,
    /// The findings that the checker must report, as the file states them.
    pub finds: String,
}

/// A cell and its verdicts from a complete search.
struct Checked {
    name: String,
    finds: String,
    cell: Text,
    verdicts: Verdicts,
}

/// Every faulty cell, checked once for all tests.
static CHECKED: LazyLock<Vec<Checked>> = LazyLock::new(|| {
    let checked = |Faulty { name, text, finds }| {
        let mut cell = cell(&text);
        // Two tests wait for this search, so it may use two threads.
        cell.plan.jobs = 2;
        let verdicts = check(&cell);
        Checked { name, finds, cell, verdicts }
    };
    faulty().into_iter().map(checked).collect()
});

/// The faulty cells. Those in the folder `inside` of it have tests of their own (`inside.rs`).
fn faulty() -> Vec<Faulty> {
    let all = faulty_in("../examples/faulty");
    assert!(all.len() >= FEWEST, "only {} faulty cells", all.len());
    all
}

/// The cells in a folder whose files state what the checker finds.
pub fn faulty_in(folder: &str) -> Vec<Faulty> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).expect("the folder of faulty cells").flatten() {
        if entry.path().is_dir() {
            continue;
        }
        let text = std::fs::read_to_string(entry.path()).expect("a cell file");
        let said = text.lines().take(2).find_map(|line| comment(line, "verify finds"));
        let Some(finds) = said.map(str::to_owned) else { continue };
        all.push(Faulty { name: entry.file_name().to_string_lossy().into_owned(), text, finds });
    }
    all.sort_by(|a, b| a.name.cmp(&b.name));
    all
}

/// The contents of a line `(* NAME: .. *)`; `None` if the line has another form.
pub fn comment<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    Some(line.strip_prefix("(* ")?.strip_prefix(name)?.strip_prefix(": ")?.strip_suffix("*)")?.trim())
}

/// The text with its wrong lines corrected; `None` if the file does not state corrections.
pub fn right(text: &str) -> Option<String> {
    let mut lines: Vec<&str> = text.lines().collect();
    let said: Vec<&str> = text.lines().filter_map(|line| comment(line, "right")).collect();
    for said in &said {
        let (number, line) = said.split_once(':').expect("a line and what it should be");
        let at = number.parse::<usize>().expect("a number") - 1;
        assert_ne!(lines[at].trim(), line.trim(), "line {number} is right already");
        lines[at] = line.trim();
    }
    (!said.is_empty()).then(|| lines.join("\n"))
}

/// All findings and warnings of a check.
pub fn all(verdicts: &Verdicts) -> impl Iterator<Item = &Finding> {
    verdicts.findings.iter().chain(&verdicts.warnings)
}

fn is_packet(note: &Note) -> bool {
    matches!(note, Note::Packet { .. })
}

/// Checks a cell completely. States bound the search, however long it takes.
fn check(text: &Text) -> Verdicts {
    let verdicts = text.check();
    assert!(verdicts.refused.is_some() || verdicts.is_complete(), "{:?}", verdicts.phases);
    verdicts
}

fn cell(text: &str) -> Text {
    let mut cell = Text::new(text);
    cell.plan.budget = within(250_000);
    cell
}

/// How many states a second search of the same cell may keep. Every finding is made within this number of states. The
/// largest cell has four times as many states; `IMRS_AGAIN=250000` is enough for it.
fn states_again() -> u64 {
    std::env::var("IMRS_AGAIN").map_or(60_000, |states| states.parse().expect("a number of states"))
}

/// A finding in the notation of the files. The cause is included only if `finds`, the line of the file, has one, too.
pub fn told(cell: &Text, finding: &Finding, finds: &str) -> String {
    let place = cell.place(finding).map_or_else(String::new, |(line, column)| format!(" {line}:{column}"));
    let short = format!("\"{}\"{place}", finding.kind.name());
    if finds.contains(&format!("{short} \"")) { format!("{short} \"{}\"", finding.cause) } else { short }
}

#[test]
fn each_fault_is_found_where_its_cell_says_and_nothing_else() {
    let (mut surprising, mut kinds) = (Vec::new(), BTreeSet::new());
    for Checked { name, finds, cell, verdicts } in CHECKED.iter() {
        let refused = verdicts.refused.as_ref().map(|refused| {
            let place = cell.place_of(refused.task, refused.at).expect("it has a place");
            format!("{NOT_CHECKED} {}:{}", place.0, place.1)
        });
        let findings = all(verdicts).map(|found| told(cell, found, finds));
        let found: Vec<String> = refused.into_iter().chain(findings).collect();
        if found.join(", ") != *finds {
            surprising.push(format!("{name}: {}, not {finds}", found.join(", ")));
        }
        kinds.extend(all(verdicts).map(|found| found.kind));
    }
    assert!(surprising.is_empty(), "{}", surprising.join("\n"));
    assert_eq!(kinds, BTreeSet::from(KINDS), "each kind has its cell");
}

/// A finding must say where it is, and where the other tasks are that it concerns.
#[test]
fn every_finding_has_a_place_and_those_whom_it_concerns_have_theirs() {
    for Checked { name, cell, verdicts, .. } in CHECKED.iter() {
        for finding in all(verdicts) {
            let what = || format!("{name}: {}: {}", finding.kind.name(), finding.cause);
            assert!(cell.place(finding).is_some(), "{}", what());
            assert!(!finding.cause.is_empty() && !finding.cause.contains("  "), "{}", what());
            let concerns = match finding.kind {
                Kind::Deadlock | Kind::TwoOwners => 2,
                Kind::Stranded | Kind::TimeOut | Kind::Starves | Kind::Check => 1,
                Kind::Standstill | Kind::WaitsForEver => 1,
                Kind::Refused
                | Kind::Ends
                | Kind::Aborts
                | Kind::LeaseLost
                | Kind::Assertion
                | Kind::ScriptFault
                | Kind::Unreached
                | Kind::Vacuous
                | Kind::Machine => 0,
            };
            assert!(finding.others.len() >= concerns, "{}: {:?}", what(), finding.others);
            for other in &finding.others {
                let place = other.at.and_then(|at| cell.place_of(other.task, at));
                let rests = other.does.starts_with("has ") || other.does.starts_with("is ");
                assert!(place.is_some() || rests, "{}: {other:?}", what());
            }
            if matches!(finding.kind, Kind::Assertion | Kind::Check) {
                assert!(finding.cause.contains(" = "), "{}: what are the values?", what());
            }
        }
    }
}

/// Only a complete search can find nothing: the largest cell alone has 250,000 states.
#[test]
fn where_the_wrong_lines_are_right_nothing_is_found() {
    for Faulty { name, text, finds } in faulty() {
        let Some(right) = right(&text) else {
            assert!(finds.starts_with(NOT_CHECKED), "{name}: what would be right?");
            continue;
        };
        let cell = cell(&right);
        let verdicts = check(&cell);
        assert!(all(&verdicts).next().is_none(), "{name}: {:?}", cell.found(&verdicts));
    }
}

#[test]
fn the_way_to_each_fault_is_told_and_the_same_twice() {
    let states = states_again();
    for Checked { name, cell, verdicts: once, .. } in CHECKED.iter() {
        let mut plan = cell.plan.clone();
        // The first search had two threads; this search has one.
        (plan.jobs, plan.budget) = (1, within(states));
        let plan = Arc::new(plan);
        let again = check_cell(&plan);
        assert_eq!(all(once).count(), all(&again).count(), "{name}");
        for (finding, other) in all(once).zip(all(&again)) {
            let way = |finding: &Finding| (finding.moves.clone(), finding.at_ticks, finding.chart.clone());
            assert_eq!(way(finding), way(other), "{name}");
            if matches!(finding.kind, Kind::Unreached | Kind::Vacuous | Kind::Machine) {
                assert!(finding.moves.is_empty(), "{name}: nothing leads there");
                continue;
            }
            let (steps, chart) = (&finding.steps, &finding.chart);
            assert!(!steps.is_empty() && steps.len() == finding.moves.len(), "{name}");
            assert_eq!(steps.last().map(|step| step.tick), Some(finding.at_ticks), "{name}");
            assert_eq!(scenes(&plan, finding).len(), steps.len() + 1, "{name}: it replays");
            let notes = steps.iter().flat_map(|step| step.notes.clone()).collect();
            let (names, notes) = drawn(&plan, finding.part, notes);
            let drawn = svg(&names, &notes, &finding.cause);
            assert_eq!(
                drawn.matches("<polygon").count(),
                notes.iter().filter(|note| is_packet(note)).count()
            );
            assert!(names.iter().all(|name| drawn.contains(&format!(">{name}</text>"))), "{name}: {names:?}");
            assert!(chart.lines().all(|line| line.chars().count() <= 78), "{name}:\n{chart}");
            assert!(chart.lines().any(|line| line.trim_start().starts_with("=> ")), "{name}:\n{chart}");
            // A cell that declares faults shows its finding only with a fault.
            let phase =
                if plan.faults.iter().all(CellFaults::are_none) { Phase::FaultFree } else { Phase::Faults };
            assert_eq!(finding.phase, phase, "{name}");
        }
    }
}

/// Findings that random runs miss. Two of these findings need a complete search; the third needs a cut and four ticks of
/// drift at certain instants.
const NOT_AT_RANDOM: [(&str, Kind); 3] = [
    ("check_of_a_door_that_never_opens.cell", Kind::Vacuous),
    ("standby_of_a_slow_clock.cell", Kind::TwoOwners),
    ("statement_after_the_last_recipe.cell", Kind::Unreached),
];

/// Runs each cell at random, also those that the checker cannot search. `IMRS_SEEDS` is the number of runs of each cell, 300
/// in `.ci/long`.
#[test]
fn random_runs_show_what_the_search_finds_and_nothing_else() {
    let mut missed = Vec::new();
    for Checked { name, cell, verdicts, .. } in CHECKED.iter() {
        let simulator = Simulator::new(&Arc::new(cell.plan.clone()), 2_000).expect("small enough");
        let all = simulator.seeds((1, number("IMRS_SEEDS", 150)), None, &mut |_, _| ());
        for found in &all.found {
            let what = || format!("{name}: {}: {:?}", found.finding.cause, found.schedule);
            assert!(verdicts.findings.iter().any(|other| is_alike(other, &found.finding)), "{}", what());
            assert!(found.shrunk.is_some_and(|shrunk| shrunk.whole), "{}", what());
            for at in 0..found.schedule.faults.len() {
                let mut less = found.schedule.clone();
                less.faults.remove(at);
                let less = simulator.schedule(&less, false);
                let shows = less.found.iter().any(|other| is_alike(&other.finding, &found.finding));
                assert!(!shows, "fault {at} is not needed: {}", what());
            }
        }
        let known = |finding: &&Finding| all.found.iter().any(|found| is_alike(&found.finding, finding));
        let here = verdicts.findings.iter().filter(|finding| !known(finding));
        missed.extend(here.map(|finding| (name.as_str(), finding.kind)));
    }
    assert_eq!(missed, NOT_AT_RANDOM);
}
