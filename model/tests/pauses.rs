//! Tests of nodes that pause: which findings pauses cause, and that the reduction of pauses changes no finding.

use crate::cells::{Text, within};
use crate::faulty_cells::right;
use crate::guard::{is_sound, number, random_text};
use imrs_model::cell::{
    CellFaults, CellMove, Fault, Kind, Pause, Phase, Schedule, Simulator, Times, Verdicts,
};
use imrs_protocol::{NodeId, Ticks};
use std::collections::BTreeSet;
use std::sync::Arc;

const SILENCE: &str = include_str!("../../examples/faulty/standby_takes_silence_for_death.cell");

fn checked(text: &str, times: Times, change: impl FnOnce(&mut Text)) -> Verdicts {
    let mut cell = Text::new(text);
    cell.plan.budget = within(200_000);
    cell.plan.times = times;
    change(&mut cell);
    let verdicts = cell.check();
    assert!(verdicts.is_complete(), "{:?}", verdicts.phases);
    verdicts
}

/// A cell of two work-coupled robots, the first of which acts for longer than its lease. `faults` declares what may go
/// wrong.
fn couple(faults: &str) -> String {
    format!(
        "cell couple; tick 1 msec; node n1; node n2; link n1 -- n2 delay 1 msec;
task r1 on n1
  port alive() usage = response user_list = {{r2}} time_out = 8 msec;
  var welds: bool;
begin
  on fence do welds := false; run stop_weld; end;
  loop welds := true; run weld takes 30 msec; welds := false; delay 5 msec; end;
end r1;
task r2 on n2 standby of r1
  use_port alive() usage = query;
begin
  loop delay 50 msec; end;
takeover
  loop run weld takes 30 msec; end;
end r2;
couple work r1 -> r2 lease 20 msec takeover 25 msec every 5 msec via alive;
{faults}
check one_active: never r1.active and r2.active;"
    )
}

#[test]
fn a_lease_holds_however_long_its_owner_pauses() {
    for length in ["", " up to 3 msec", " up to 24 msec", " up to 60 msec"] {
        let verdicts = checked(&couple(&format!("faults pause r1{length};")), Times::Ends, |_| ());
        assert!(verdicts.findings.is_empty(), "{length}: {:?}", verdicts.findings);
        // A pause shorter than the lease less a heartbeat has no effect. A longer pause makes the standby take over.
        let took_over = verdicts.statements[1];
        assert_eq!(took_over.0 == took_over.1, length != " up to 3 msec", "{length}: {took_over:?}");
        assert!(verdicts.still.is_empty() == (length != " up to 3 msec"), "{length}: {:?}", verdicts.still);
    }
    // The property of the lease also holds if any node may pause twice.
    let verdicts = checked(&couple(""), Times::Ends, |cell| {
        let pause = Pause::new(&cell.plan.table, None, Some(Ticks(30)));
        cell.plan.faults = vec![CellFaults { pause: vec![pause; 2], ..CellFaults::default() }];
    });
    assert!(verdicts.findings.is_empty(), "{:?}", verdicts.findings);
}

#[test]
fn a_standby_that_takes_silence_for_death_is_found_and_its_chart_shows_the_pause() {
    for times in [Times::Ends, Times::Between, Times::Every] {
        let verdicts = checked(SILENCE, times, |_| ());
        let found = verdicts.of(Kind::Check).next().expect("both weld");
        assert!(found.chart.contains("PAUSES"), "{}", found.chart);
        assert!(found.moves.iter().any(|step| step.is_fault()), "{:?}", found.moves);
        let verdicts = checked(&right(SILENCE).expect("it says what is right"), times, |_| ());
        assert!(verdicts.findings.is_empty(), "{times:?}: {:?}", verdicts.findings);
    }
    let none = SILENCE.replace("faults pause r1 up to 100 msec;", "");
    let verdicts = checked(&none, Times::Every, |_| ());
    assert!(verdicts.of(Kind::Check).next().is_none(), "it takes a pause");
    let short = SILENCE.replace("up to 100 msec", "up to 30 msec");
    let verdicts = checked(&short, Times::Every, |_| ());
    assert!(verdicts.of(Kind::Check).next().is_none(), "and a long one");
}

/// A cell in which one task decides and acts. The task is done within 25 msec, unless its node pauses between the decision
/// and the action.
const DECIDED: &str = "cell decided; tick 1 msec; node na;
task a on na
  var goes, done: bool;
begin
  goes := true; run go takes 10 msec; goes := false; done := true;
end a;
faults pause a up to 20 msec;
check soon: a.goes leads a.done within 25 msec;";

#[test]
fn a_pause_may_come_between_a_decision_and_its_action() {
    // In this cell another statement runs the same action with other times.
    let twice = DECIDED.replace("done := true;", "done := true; run go takes 7 msec;");
    for (text, times) in [Times::Ends, Times::Between, Times::Every]
        .map(|times| (DECIDED, times))
        .into_iter()
        .chain([(&twice[..], Times::Ends)])
    {
        let verdicts = checked(text, times, |_| ());
        let found = verdicts.of(Kind::Check).next().expect("20 and 10 are more than 25");
        assert!(
            found.moves.iter().any(|step| matches!(step, CellMove::PauseBefore(..))),
            "{:?}",
            found.moves
        );
        assert!(found.chart.contains("PAUSES, before its action"), "{}", found.chart);
        // An action that runs during the pause has ended when the pause ends.
        let verdicts = checked(&text.replace("within 25", "within 30"), times, |_| ());
        assert!(verdicts.of(Kind::Check).next().is_none(), "{:?}", verdicts.findings);
    }
}

/// A packet ages while it waits for a paused node, so the node gets no expired packet.
#[test]
fn a_message_that_waits_for_a_paused_node_ages() {
    let text = "cell old; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na
  port put() usage = send user_list = {b} time_out = 20 msec class = 1;
begin
  send put();
end a;
task b on nb
  use_port put() usage = receive;
begin
  receive put() within 300 msec on time_out do assert false; end;
end b;";
    // The message arrives after a tick, and then waits as long as the node is paused.
    let misses = |text: &str, lasts: u32| {
        let pause = Fault::Pause { node: NodeId(1), at: 0, lasts, before_action: false };
        let schedule = Schedule { faults: vec![pause], ..Schedule::default() };
        let simulator = Simulator::new(&Arc::new(Text::new(text).plan), 100).expect("small enough");
        let run = simulator.schedule(&schedule, false);
        assert!(run.idle.is_empty(), "{:?}", run.idle);
        run.found.iter().any(|found| found.finding.kind == Kind::Assertion)
    };
    assert_eq!([1, 18, 19, 24].map(|lasts| misses(text, lasts)), [false, false, true, true]);
    let longer = text.replace("time_out = 20 msec", "time_out = 60 msec");
    assert_eq!([24, 58, 59].map(|lasts| misses(&longer, lasts)), [false, false, true]);
}

/// A node counts the ticks of its pause, so a timer that ends after the pause ends on time.
#[test]
fn a_timer_that_outlasts_a_pause_ends_on_time() {
    let text = "cell ring; tick 1 msec; node na;
task a on na
  var begun, rang: bool; var t: timer;
begin
  order t > self;
  on expiry t do rang := true; end;
  begun := true; start t 20 msec;
  run look takes 5 msec;
  loop delay 100 msec; end;
end a;
check in_time: a.begun leads a.rang within 20 msec;";
    let breaks = |text: &str| {
        // The action ends after 5 ticks. This end is the first thing that the node would notice.
        let pause = Fault::Pause { node: NodeId(0), at: 5, lasts: 10, before_action: false };
        let schedule = Schedule { faults: vec![pause], ..Schedule::default() };
        let simulator = Simulator::new(&Arc::new(Text::new(text).plan), 100).expect("small enough");
        let run = simulator.schedule(&schedule, false);
        assert!(run.idle.is_empty(), "{:?}", run.idle);
        run.found.iter().any(|found| found.finding.kind == Kind::Check)
    };
    assert!(!breaks(text));
    assert!(breaks(&text.replace("within 20", "within 19")));
}

/// If the reduced search left out a needed moment for a pause or a wake-up, it would miss a finding here.
#[test]
fn pauses_at_any_moment_find_no_more() {
    for text in [SILENCE, DECIDED, &couple("faults pause r1 up to 30 msec;")] {
        let [reduced, whole] = [false, true].map(|everything| {
            let mut cell = Text::new(text);
            cell.plan.budget = within(400_000);
            (cell.plan.times, cell.plan.everything) = (Times::Ends, everything);
            cell.check()
        });
        let keys = |verdicts: &Verdicts| {
            let findings = verdicts.findings.iter();
            findings.map(|found| (found.kind, found.task, found.address, found.check)).collect::<Vec<_>>()
        };
        assert_eq!(keys(&reduced), keys(&whole), "{text}");
        assert_eq!(reduced.statements, whole.statements, "{text}");
    }
}

/// The same comparison with random cells: 400 in `.ci/long`. `PAUSE_SEED` is the first seed.
#[test]
fn random_pauses_at_any_moment_find_no_more() {
    let (cells, first) = (number("PAUSE_CELLS", 40), number("PAUSE_SEED", 1));
    let with_a_pause = |text: &String| text.contains("faults pause") && is_sound(text);
    let seeds = (first..).map(|seed| (seed, random_text(seed))).filter(|(_, text)| with_a_pause(text));
    let (mut compared, mut with_findings, mut differing) = (0_u64, 0_u64, Vec::new());
    for (seed, text) in seeds.take(usize::try_from(cells).expect("a small number")) {
        let mut cell = Text::new(&text);
        cell.plan.budget = within(number("PAUSE_STATES", 10_000));
        cell.plan.times = Times::Ends;
        cell.plan.everything = true;
        if cell.is_too_large_without_faults() {
            continue;
        }
        let whole = cell.check();
        if !whole.is_complete() {
            continue;
        }
        cell.plan.everything = false;
        let reduced = cell.check();
        assert!(reduced.is_complete(), "PAUSE_SEED={seed}:\n{text}");
        // A part may be at a standstill while the cell as a whole goes on (D138).
        if reduced.phases.iter().any(|phase| phase.parts > 1) {
            continue;
        }
        compared += 1;
        let keys = |verdicts: &Verdicts| {
            let findings = verdicts.findings.iter();
            let kind = |kind| if kind == Kind::Starves { Kind::TimeOut } else { kind };
            findings
                .map(|found| (kind(found.kind), found.phase, found.task, found.address, found.check))
                .collect::<BTreeSet<_>>()
        };
        let [mine, others] = [&reduced, &whole].map(keys);
        with_findings += u64::from(mine.iter().any(|(_, phase, ..)| *phase == Phase::Faults));
        if mine != others || reduced.statements != whole.statements {
            println!("{text}");
            let reached = [&reduced.statements, &whole.statements];
            differing.push(format!(
                "PAUSE_SEED={seed} PAUSE_CELLS=1: {mine:?}, without reductions {others:?}; {reached:?}"
            ));
        }
    }
    println!(
        "{compared} of {cells} cells compared, {with_findings} of them with a finding that takes a fault"
    );
    assert!(differing.is_empty(), "{}", differing.join("\n"));
    assert!(cells < 40 || compared >= 10 && with_findings >= 2, "{compared} {with_findings}");
}

#[test]
fn a_pause_without_a_length_is_longer_than_anything_waits() {
    let cell = Text::new(&couple("faults pause n2;"));
    let [faults] = &cell.plan.faults[..] else { panic!("one hypothesis") };
    assert_eq!(faults.pause, [Pause { node: Some(NodeId(1)), most: 26 }], "the take-over and a tick");
    let cell = Text::new(SILENCE);
    assert_eq!(cell.plan.faults[0].pause, [Pause { node: Some(NodeId(0)), most: 100 }]);
}
