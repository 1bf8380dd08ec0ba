//! Compares the search by zones with the search at every tick: both must find and reach the same.

mod growing;

use crate::cells::{Text, within};
use crate::guard::{dice, is_sound, number, random_cell, random_text};
use imrs_model::cell::{
    Agreement, Budget, CellFaults, Coverage, Finding, Kind, Phase, SearchProgress, Times, Verdicts,
    check_cell, check_cell_and_tell, compare_zones_with_walks,
};
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The greatest number of states of a search at every tick. Larger searches are left out.
fn states() -> u64 {
    number("IMRS_STATES", 4_000)
}

/// Whether a finding is about tasks that wait for ever while others go on. The search at every tick looks for such tasks
/// only in some states, which depend on what it keeps. The search by zones looks in all states.
fn waits(found: &Finding) -> bool {
    matches!(found.kind, Kind::Deadlock | Kind::WaitsForEver)
}

fn words(all: &[impl Debug]) -> impl Iterator<Item = String> {
    all.iter().map(|one| format!("{one:?}"))
}

/// The facts in which both searches must agree: the findings, and what was reached.
fn told(verdicts: &Verdicts, is_pruned: bool) -> Vec<String> {
    // A search that stopped at a finding proves nothing about the statements that it did not reach.
    let is_told = |found: &&Finding| !(waits(found) || is_pruned && found.kind == Kind::Unreached);
    let found = verdicts.findings.iter().filter(is_told).map(|found| {
        // Starvation counts as a time_out, because the search examines only one path to decide between the two.
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

/// Whether a search by zones looked at more times than can occur.
fn has_more(zones: &Verdicts) -> bool {
    zones.phases.iter().any(|phase| phase.inexact > 0)
}

/// The findings, without unreached statements.
fn found(verdicts: &Verdicts) -> Vec<String> {
    let reached: BTreeSet<String> = words(&verdicts.statements).chain(words(&verdicts.still)).collect();
    told(verdicts, true).into_iter().filter(|fact| !reached.contains(fact)).collect()
}

/// The tasks that wait for ever, and where.
fn waiting(verdicts: &Verdicts) -> BTreeSet<String> {
    let found = verdicts.findings.iter().chain(&verdicts.warnings).filter(|found| waits(found));
    found.map(|found| format!("{:?} at {:?}", found.task, found.address)).collect()
}

/// Whether a task goes on for ever without progress.
fn stands_still(verdicts: &Verdicts) -> bool {
    verdicts.warnings.iter().any(|found| found.kind == Kind::Standstill)
}

/// How many searches were compared, and how many states they had.
#[derive(Debug, Default)]
struct Compared {
    cells: u64,
    phases: u64,
    findings: u64,
    still: u64,
    missed: u64,
    every: u64,
    zones: u64,
    /// For searches by zones that were also made without reductions: the number of states with reductions. The next field
    /// has the number without.
    reduced: u64,
    plain: u64,
    /// The number of cells whose search by zones was inexact: it also covered times that cannot occur.
    inexact: u64,
    /// The number of cells whose search is inexact only if it keeps one zone for each control (a state without its
    /// times).
    hulls: u64,
}

impl Compared {
    fn add(&mut self, other: &Self) {
        self.cells += other.cells;
        self.phases += other.phases;
        self.findings += other.findings;
        self.still += other.still;
        self.missed += other.missed;
        self.every += other.every;
        self.zones += other.zones;
        self.reduced += other.reduced;
        self.plain += other.plain;
        self.inexact += other.inexact;
        self.hulls += other.hulls;
    }
}

/// Compares the verdicts of the search by zones and of the search at every tick; `None` if the search at every tick takes
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
    let has_more = has_more(&zones);
    assert_eq!(found(&zones), found(&every), "{name}, by zones and at every tick");
    assert!(
        has_more || told(&zones, is_pruned) == told(&every, is_pruned),
        "{name}, by zones and at every tick"
    );
    // Zones miss a standstill to which only some times of a zone lead.
    assert!(stands_still(&every) || !stands_still(&zones), "{name}: a standstill only by zones");
    let missed = u64::from(stands_still(&every) && !stands_still(&zones));
    let (plain, reduced) = compare_plain(name, cell, &zones);
    let hulls = compare_hulls(name, cell, (&every, &zones));
    let inexact = u64::from(has_more);
    let (phases, findings) = (zones.phases.len() as u64, zones.findings.len() as u64);
    let still = u64::from(stands_still(&zones));
    let (every, zones) = (kept(&every), kept(&zones));
    Some(Compared { cells: 1, phases, findings, still, missed, every, zones, reduced, plain, inexact, hulls })
}

fn kept(verdicts: &Verdicts) -> u64 {
    verdicts.phases.iter().map(|phase| phase.states).sum()
}

/// Compares the verdict by zones with the verdict by zones without reductions. Returns the numbers of states of both, or
/// zeros if the search without reductions takes too many.
fn compare_plain(name: &str, cell: &mut Text, zones: &Verdicts) -> (u64, u64) {
    cell.plan.everything = true;
    let plain = check_cell(&Arc::new(cell.plan.clone()));
    cell.plan.everything = false;
    if !plain.is_complete() {
        return (0, 0);
    }
    assert_eq!(waiting(zones), waiting(&plain), "{name}, with and without reductions");
    assert_eq!(found(zones), found(&plain), "{name}, with and without reductions");
    let has_more = has_more(zones) || has_more(&plain);
    assert!(has_more || told(zones, false) == told(&plain, false), "{name}, with and without reductions");
    (kept(&plain), kept(zones))
}

/// Compares a search that keeps one zone for each control: a second zone is joined with the first one to their hull,
/// the least zone that includes both. The search must find the same, but may reach more statements and waits, at times
/// that only a hull has. Returns 1 if hulls made the search inexact.
fn compare_hulls(name: &str, cell: &mut Text, (every, zones): (&Verdicts, &Verdicts)) -> u64 {
    let usual = std::mem::replace(&mut cell.plan.zones, 1);
    let hulls = check_cell(&Arc::new(cell.plan.clone()));
    cell.plan.zones = usual;
    if !hulls.is_complete() {
        return 0;
    }
    assert!(waiting(&hulls).is_superset(&waiting(every)), "{name}, with hulls and at every tick");
    assert_eq!(found(&hulls), found(every), "{name}, with hulls and at every tick");
    let mut both = hulls.statements.iter().zip(&every.statements);
    assert!(
        both.all(|(mine, others)| mine.0 >= others.0),
        "{name}: a statement is reached only at every tick"
    );
    u64::from(has_more(&hulls) && !has_more(zones))
}

fn covered(faults: &CellFaults) -> bool {
    faults.pause.is_empty() && faults.drift == 0
}

#[test]
fn random_cells_are_found_the_same_by_zones() {
    let (cells, first) = (number("IMRS_CELLS", 120), number("IMRS_SEED", 1));
    let mut all = Compared::default();
    for seed in first..first + cells {
        let text = random_text(seed);
        // The same cell at half the tick: its times are twice as many ticks.
        for tick in ["tick 1 msec;", "tick 500 usec;"] {
            let text = text.replacen("tick 1 msec;", tick, 1);
            if !is_sound(&text) {
                continue;
            }
            let name = format!("IMRS_SEED={seed} IMRS_CELLS=1, {tick}");
            let Some(one) = compare(&name, &mut Text::new(&text), states()) else { continue };
            all.add(&one);
        }
    }
    println!("{all:?}");
    assert!(all.cells * 2 > cells && all.findings > cells, "{all:?}");
    assert!(all.still > 0 && all.missed * 100 <= cells, "{all:?}");
    assert!(all.zones < all.every && all.reduced < all.plain && all.hulls * 4 > all.cells, "{all:?}");
}

/// The state of a random walk at plain ticks, between any two instants, must be in a kept zone.
#[test]
fn walks_stay_within_the_kept_zones() {
    let (cells, first) = (number("IMRS_CELLS", 120), number("IMRS_SEED", 1));
    let mut all = Agreement::default();
    for seed in first..first + cells {
        let Some(mut cell) = random_cell(seed) else { continue };
        cell.plan.faults.retain(covered);
        cell.plan.budget = within(2 * states());
        let mut dice = dice(seed);
        match compare_zones_with_walks(&Arc::new(cell.plan), (6, 150), &mut |limit| dice.below(limit)) {
            Ok(one) => all += one,
            Err(differs) => panic!("IMRS_SEED={seed} IMRS_CELLS=1: {differs}\n{}", random_text(seed)),
        }
    }
    println!("{all:?}");
    assert!(all.looked_up > 100 * cells && all.complete * 2 > all.searches, "{all:?}");
}

/// The seconds of processor time that this process has used, and the most memory.
fn used() -> (f64, String) {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11).take(2);
    let ticks: u32 = ticks.filter_map(|ticks| ticks.parse::<u32>().ok()).sum();
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("?").trim();
    (f64::from(ticks) / 100.0, peak.into())
}

/// Prints a line of a table for each search of a cell: its states, its seconds of processor time, and the most memory that this
/// process has used.
struct Rows<'a> {
    name: &'a str,
    before: std::cell::Cell<f64>,
}

impl SearchProgress for Rows<'_> {
    fn finished(&self, phase: &Coverage) {
        let (seconds, peak) = used();
        let took = seconds - self.before.replace(seconds);
        let faults = match phase.phase {
            Phase::FaultFree => "none".into(),
            Phase::Faults => format!("{}", phase.hypothesis + 1),
        };
        let ended = phase.ended_by.as_deref().unwrap_or("complete");
        let Coverage { times, states, inexact, moves, .. } = phase;
        println!(
            "| {} | {faults} | {times:?} | {states} | {inexact} | {moves} | {took:.1} | {ended} | {peak} |",
            self.name
        );
    }
}

fn measure(name: &str, cell: &mut Text, seconds: u64) {
    cell.plan.faults.retain(covered);
    cell.plan.budget = Budget { seconds: Duration::from_secs(seconds).as_secs_f64(), ..Budget::default() };
    cell.plan.zones =
        usize::try_from(number("IMRS_ZONES", cell.plan.zones as u64)).expect("a number of zones");
    cell.plan.jobs = usize::try_from(number("IMRS_JOBS", 1)).expect("a number of threads");
    let every = std::env::var("IMRS_EVERY").is_ok().then_some(Times::Every);
    for times in std::iter::once(Times::Zones).chain(every) {
        cell.plan.times = times;
        let verdicts =
            check_cell_and_tell(&Arc::new(cell.plan.clone()), &Rows { name, before: used().0.into() });
        assert!(verdicts.refused.is_none(), "{:?}", verdicts.refused);
    }
}

/// A message expires while it waits for its receiver. The time that it spent on its link does not change the instant of
/// expiry.
#[test]
fn a_message_that_waits_expires_at_the_same_instant_by_zones() {
    let text = |work: &str| {
        format!(
            "cell late;\ntick 1 msec;\nnode na; node nb;\nlink na -- nb delay 6 msec;\n\
            task a on na\nport put(x: int16) usage = send user_list = {{b}} time_out = 12 msec class = 1;\nbegin\n\
            run look takes 1..3 msec; send put(1);\nend a;\n\
            task b on nb\nuse_port put(x: int16) usage = receive;\nvar m: int16; var got: bool;\nbegin\n\
            run work takes {work} msec;\n\
            receive put(m) within 1 msec on time_out do skip; end;\ngot := m = 1;\nend b;\ncheck c: never b.got;\n"
        )
    };
    // The message is sent after 1 to 3 msec and expires 12 msec later. The check fails if `b` takes the message.
    let cases = [("2", true), ("6", true), ("14", true), ("15", false), ("16..20", false), ("12..20", true)];
    for (work, is_got) in cases {
        let mut cell = Text::new(&text(work));
        let compared = compare(work, &mut cell, states()).expect("it is small");
        assert!(compared.zones > 1, "{work}: {compared:?}");
        let verdicts = cell.check();
        assert_eq!(verdicts.of(Kind::Check).next().is_some(), is_got, "{work}: {:?}", verdicts.findings);
    }
}

/// A lost heartbeat lets the lease end. The heartbeat's arrival leads to the same control (a state without its times)
/// as its loss, but at other times.
#[test]
fn a_lease_that_a_loss_ends_ends_by_zones_too() {
    let text = |lease: u64, faults: &str| {
        format!(
            "cell lease;\ntick 1 msec;\nnode left; node right;\nlink left -- right delay 1 msec;\n\
            task first on left\nport alive(n: int8) usage = response user_list = {{second}} time_out = 20 msec class = 2;\n\
            var lost: bool;\nbegin\non fence do lost := true; end;\ndelay 60 msec;\nend first;\n\
            task second on right standby of first\nuse_port alive(n: int8) usage = query;\nbegin\nloop delay 10 msec; end;\n\
            takeover\ndelay 1 msec;\nend second;\n\
            couple work first -> second lease {lease} msec takeover 60 msec every 4 msec via alive;\n\
            {faults}check c: never first.lost;\n"
        )
    };
    let cases = [(12, "", false), (12, "faults loss 1;\n", true), (13, "faults loss 1;\n", false)];
    for (lease, faults, is_lost) in cases {
        let mut cell = Text::new(&text(lease, faults));
        compare(faults, &mut cell, 8 * states()).expect("it is small");
        let verdicts = cell.check();
        assert_eq!(
            verdicts.of(Kind::Check).next().is_some(),
            is_lost,
            "{lease} {faults}: {:?}",
            verdicts.findings
        );
    }
}

/// After a restart the script of `b` is held back for 7 ticks: its time_out and the delay of its link. Its query then
/// takes one tick more. Both searches share the code that holds a script back, so this test states the two times.
#[test]
fn a_script_that_is_held_back_begins_on_time() {
    let text = |until: u64| {
        format!(
            "cell again;\ntick 10 msec;\nnode na; node nb;\nlink na -- nb delay 10 msec;\n\
            task a on na\nuse_port up(n: int8) -> int8 usage = response;\nvar starts: int8; var over: bool;\nbegin\n\
            order up > self;\non query up(n) do starts := starts + 1; response(n); end;\n\
            delay {until} msec; over := true;\nloop delay 1 sec; end;\nend a;\n\
            task b on nb\nport up(n: int8) -> int8 usage = query user_list = {{a}} time_out = 60 msec class = 2;\n\
            var n: int8;\nbegin\nquery up(1) -> n on time_out do skip; end;\nend b;\n\
            faults crash nb;\ncheck once: never a.starts > 1 and not a.over;\n"
        )
    };
    for (until, has_come) in [(70, false), (80, true)] {
        let mut cell = Text::new(&text(until));
        compare("again", &mut cell, states()).expect("it is small");
        let verdicts = cell.check();
        assert_eq!(verdicts.of(Kind::Check).next().is_some(), has_come, "{until}: {:?}", verdicts.findings);
    }
}

#[test]
fn examples_are_found_the_same_by_zones() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let one = std::env::var("IMRS_CELL").ok();
    let mut compared = 0;
    for entry in std::fs::read_dir(folder).expect("the examples") {
        let path = entry.expect("an entry").path();
        if path.extension().is_none_or(|extension| extension != "cell") {
            continue;
        }
        if let Some(one) = &one {
            if path.file_stem().is_some_and(|stem| stem == one.as_str()) {
                let text = std::fs::read_to_string(&path).expect("a cell");
                measure(one, &mut Text::new(&text), number("IMRS_SECONDS", 30));
                return;
            }
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a cell");
        let one = compare(&path.display().to_string(), &mut Text::new(&text), 12 * states());
        println!("{}: {one:?}", path.display());
        compared += u64::from(one.is_some());
    }
    assert!(compared > 0, "no example is small enough");
}
