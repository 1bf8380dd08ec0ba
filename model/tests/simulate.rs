//! Random runs of a cell: their findings, how findings are shrunk, and that the runs make only moves that the search also
//! makes.

use crate::cells::{Text, is_alike, within};
use crate::guard::{number, random_cell};
use imrs_model::cell::{
    CellMove, CellPlan, Chooser, Ended, Fault, Found, Kind, Phase, Schedule, Simulated, Simulator, Tape,
    Times, check_cell, scenes,
};
use imrs_protocol::{NodeId, TaskId};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

fn example(name: &str) -> Text {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name);
    Text::new(&std::fs::read_to_string(path).expect("a cell"))
}

fn simulator(plan: &CellPlan, steps: u32) -> Simulator {
    Simulator::new(&Arc::new(plan.clone()), steps).expect("small enough")
}

fn seeds(plan: &CellPlan, steps: u32, (first, count): (u64, u64)) -> Simulated {
    simulator(plan, steps).seeds((first, count), None, &mut |_, _| ())
}

fn node(number: usize) -> NodeId {
    NodeId::from_index(number)
}

/// The parts of a finding that its schedule determines.
fn told(found: &Found) -> impl PartialEq + std::fmt::Debug {
    let finding = &found.finding;
    (
        finding.kind,
        finding.cause.clone(),
        finding.moves.clone(),
        finding.chart.clone(),
        found.schedule.clone(),
    )
}

#[test]
fn the_same_seeds_show_the_same_for_any_number_of_threads() {
    for name in ["faulty/part_placed_twice.cell", "faulty/two_feeders_in_a_hurry.cell", "weld_cell.cell"] {
        let mut plan = example(name).plan;
        let [one, other] = [1, 3].map(|jobs| {
            plan.jobs = jobs;
            seeds(&plan, 500, (7, 200))
        });
        let numbers = |all: &Simulated| (all.runs, all.with_faults, all.steps, all.ticks, all.ended);
        assert_eq!(numbers(&one), numbers(&other), "{name}");
        assert_eq!(one.statements, other.statements, "{name}");
        assert_eq!(one.not_reached, other.not_reached, "{name}");
        let all =
            |all: &Simulated| all.found.iter().map(|found| (found.seed, found.runs)).collect::<Vec<_>>();
        assert_eq!(all(&one), all(&other), "{name}");
        assert!(one.found.iter().map(told).eq(other.found.iter().map(told)), "{name}");
        let others = seeds(&plan, 500, (1_007, 200));
        assert_ne!(numbers(&one), numbers(&others), "{name}: the seeds make no difference");
    }
}

/// The run of a single seed shows the same findings as the run of this seed among many, and so does its schedule.
#[test]
fn a_seed_and_a_schedule_show_again_what_was_found() {
    for name in
        ["part_placed_twice", "token_lost_on_the_way", "gripper_that_does_not_close", "arms_over_one_place"]
    {
        let cell = example(&format!("faulty/{name}.cell"));
        let all = seeds(&cell.plan, 1_000, (1, 200));
        let found = all.found.first().unwrap_or_else(|| panic!("{name}: nothing in 200 runs"));
        let again = seeds(&cell.plan, 1_000, (found.seed.expect("a seed"), 1));
        assert!(again.found.iter().any(|other| told(other) == told(found)), "{name}: {again:?}");
        let replayed = simulator(&cell.plan, 1_000).schedule(&found.schedule, false);
        assert!(replayed.found.iter().any(|other| told(other) == told(found)), "{name}: {replayed:?}");
        assert!(
            replayed.idle.is_empty(),
            "{name}: each fault of a shrunk schedule happens: {:?}",
            replayed.idle
        );
        let shrunk = found.shrunk.expect("shrunk");
        assert!(found.finding.moves.len() <= 2 * shrunk.moves + 64, "{name}: {shrunk:?}");
        assert!(
            found.schedule.faults.len() <= 1 && found.schedule.faults.len() <= shrunk.faults,
            "{name}: {found:?}"
        );
        assert!(found.schedule.choices() <= shrunk.choices, "{name}: {shrunk:?}");
    }
}

/// Charts, recordings and causes replay the moves of a finding. If a move panics in that replay, it is the last move that
/// is shown.
#[test]
fn a_finding_whose_last_move_panics_is_shown() {
    let mut plan = example("faulty/part_placed_twice.cell").plan;
    let mut found = seeds(&plan, 1_000, (1, 50)).found.remove(0);
    let steps = found.finding.moves.len();
    // This cell never has 200 packets in flight, so the move that names packet 200 panics.
    found.finding.moves.insert(steps / 2, CellMove::Duplicate(200));
    found.finding.phase = Phase::Faults;
    plan.faults = vec![found.faults];
    let shown = scenes(&Arc::new(plan), &found.finding);
    assert_eq!(shown.len(), 1 + steps / 2 + 1, "the start, the moves before the panic, and the panic");
}

/// The stop flag ends batches and shrinking. Findings up to that point are returned, each of them complete.
#[test]
fn a_stop_ends_batches_and_shrinking() {
    let mut plan = example("faulty/part_placed_twice.cell").plan;
    for jobs in [1, 3] {
        plan.jobs = jobs;
        let stopped_at = |least: usize| {
            let stop = Arc::new(AtomicBool::new(false));
            let simulator = simulator(&plan, 1_000).stopped_by(&stop);
            simulator.seeds((1, 100_000_000), None, &mut |_, found| {
                stop.store(found >= least, Ordering::Relaxed);
            })
        };
        let none = stopped_at(0);
        assert!(none.interrupted && none.runs == 0 && none.found.is_empty(), "{none:?}");
        let one = stopped_at(1);
        let found = &one.found[0];
        assert!(one.interrupted && one.runs > 0, "{one:?}");
        assert!(
            found.shrunk.is_some_and(|shrunk| !shrunk.whole && shrunk.moves == found.finding.moves.len())
        );
        assert!(found.finding.kind == Kind::Check && !found.finding.chart.is_empty(), "{found:?}");
        let stop = Arc::new(AtomicBool::new(true));
        let replayed = simulator(&plan, 1_000).stopped_by(&stop).schedule(&found.schedule, true);
        assert!(replayed.interrupted && replayed.runs == 0, "{replayed:?}");
    }
}

/// With fast packets the query is rejected until its time_out, so it starves. With slow packets, which shrinking prefers,
/// the query only times out.
const NOT_SERVED: &str = "cell served;
tick 1 msec;
node n1; node n2;
link n1 -- n2 delay 35 msec;
task inspector on n1
  port look() -> bool usage = query user_list = {arm} time_out = 75 msec penalty = paper 45 msec;
  var ok: bool;
begin query look() -> ok on time_out do skip; end; end inspector;
task arm on n2
  use_port look() -> bool usage = response;
begin
  order self > look;
  on query look() do response(true); end;
  run weld takes 200 msec;
end arm;
";

#[test]
fn shrinking_keeps_the_kind_of_a_finding() {
    let all = seeds(&Text::new(NOT_SERVED).plan, 1_000, (1, 200));
    let mut kinds: Vec<Kind> = all.found.iter().map(|found| found.finding.kind).collect();
    kinds.sort_unstable();
    assert_eq!(kinds, [Kind::TimeOut, Kind::Starves], "{:?}", all.found);
}

/// A cell of two tasks that do the same, each with a wrong assertion.
const TWINS: &str = "cell twins;
tick 1 msec;
node n1; node n2;
link n1 -- n2 delay 1 msec;
task left on n1
  var parts: int8;
begin run grip takes 1..9 msec; assert parts > 0; end left;
task right on n2
  var parts: int8;
begin run grip takes 1..9 msec; assert parts > 0; end right;
";

#[test]
fn a_finding_of_tasks_with_the_same_statements_is_told_once() {
    let plan = Text::new(TWINS).plan;
    let all = seeds(&plan, 1_000, (1, 100));
    let told: Vec<_> =
        all.found.iter().map(|found| (found.finding.task, &found.finding.also[..], found.runs)).collect();
    let [one, other] = [0, 1].map(TaskId::from_index);
    assert!(told == [(Some(one), &[other][..], 100)] || told == [(Some(other), &[one][..], 100)], "{told:?}");
}

#[test]
fn what_is_sound_shows_nothing() {
    for name in ["beam_lift", "weld_cell", "press_line", "shared_tool", "conveyor", "carry", "belt"] {
        let all = seeds(&example(&format!("{name}.cell")).plan, 1_000, (1, 300));
        let causes: Vec<_> = all.found.iter().map(|found| (&found.finding.cause, &found.schedule)).collect();
        assert!(causes.is_empty(), "{name}: {causes:?}");
        assert!(all.runs == 300 && all.steps > 30_000, "{name}: {all:?}");
        assert_eq!(all.ended.iter().sum::<u64>(), 300, "{name}");
    }
}

/// Random runs make only moves of the search: the search finds everything that they show, and no run reaches a statement
/// that the search calls unreached.
#[test]
fn the_search_finds_what_random_runs_of_random_cells_show() {
    let cells = number("IMRS_CELLS", 70);
    let (mut compared, mut found) = (0, 0);
    for seed in 1..=cells {
        let Some(mut cell) = random_cell(seed) else { continue };
        (cell.plan.times, cell.plan.budget) = (Times::Every, within(20_000));
        if cell.is_too_large_without_faults() {
            continue;
        }
        let verdicts = check_cell(&Arc::new(cell.plan.clone()));
        if !verdicts.is_complete() {
            continue;
        }
        compared += 1;
        let all = seeds(&cell.plan, 300, (seed, 100));
        for one in &all.found {
            let is_known = verdicts.findings.iter().any(|other| is_alike(other, &one.finding));
            assert!(is_known, "cell {seed}: {}: {:?}", one.finding.cause, one.schedule);
        }
        found += all.found.len() as u64;
        let never = verdicts.of(Kind::Unreached).filter_map(|finding| finding.task.zip(finding.address));
        for place in never.chain(verdicts.not_exercised.clone()).chain(verdicts.not_tried.clone()) {
            assert!(all.not_reached.contains(&place), "cell {seed}: the search has not reached {place:?}");
        }
    }
    println!("{compared} of {cells} cells compared, {found} findings");
    assert!(
        compared * 10 >= cells * 7 && found * 2 >= cells,
        "{compared} of {cells} cells, {found} findings"
    );
}

/// A cell in which one robot queries another one three times.
const ASKS: &str = "cell asks;
tick 1 msec;
node n1; node n2;
link n1 -- n2 delay 2 msec;
task asker on n1
  port where() -> int8 usage = query user_list = {teller} time_out = 20 msec class = 2;
  var at: int8; var missed: int8;
begin
  while at < 3 do
    query where() -> at on time_out do missed := missed + 1; at := 3; end;
    run go takes 5..9 msec;
  end;
end asker;
task teller on n2
  use_port where() -> int8 usage = response;
  var n: int8;
begin
  loop receive where(); n := n + 1; response(n); end;
end teller;
check none_missed: never asker.missed > 0;
check in_time: never asker.missed > 1;
";

#[test]
fn one_fault_happens_where_the_plan_says() {
    let cell = Text::new(ASKS);
    let simulator = simulator(&cell.plan, 1_000);
    let (to, back) = ((node(0), node(1)), (node(1), node(0)));
    let with = |fault: &Fault| Schedule { faults: vec![fault.clone()], tape: Tape::new() };
    let packets = [(to, 1), (to, 3), (back, 2)];
    let lost = packets.map(|(link, nth)| Fault::Lose { link, nth });
    let gone = [
        Fault::Stop { node: node(1), at: 0, restart: None },
        Fault::Cut { link: 0, at: 0, lasts: None },
        Fault::Cut { link: 0, at: 10, lasts: Some(5) },
    ];
    for fault in lost.into_iter().chain(gone) {
        let all = simulator.schedule(&with(&fault), false);
        let checks: Vec<_> = all.found.iter().map(|found| found.finding.check).collect();
        assert_eq!((checks, &all.idle[..]), (vec![Some(0)], &[][..]), "{fault:?}");
        assert!(all.found[0].with_faults(), "{fault:?}");
        // The runs of these seeds have the given fault, and random choices.
        let any = simulator.seeds((1, 20), Some(std::slice::from_ref(&fault)), &mut |_, _| ());
        assert!(any.found[0].runs == 20 && any.with_faults == 20, "{fault:?}: {any:?}");
        assert!(any.idle.is_empty(), "{fault:?}: {any:?}");
    }
    // A duplicate happens but has no effect, because the receiver answers it with the same answer. The faults after it
    // never happen.
    let copied = Fault::Copy { link: to, nth: 2 };
    let all = simulator.schedule(&with(&copied), false);
    assert!(all.found.is_empty() && all.idle.is_empty(), "{all:?}");
    let idle = [
        Fault::Lose { link: to, nth: 4 },
        Fault::Fail { task: TaskId::from_index(0), nth: 4 },
        Fault::Overtake { link: back, nth: 1 },
        Fault::Cut { link: 0, at: 5_000, lasts: None },
    ];
    let drift = Fault::Drift { node: node(0), at: 0, more: true };
    for fault in idle {
        let all = simulator.schedule(&with(&fault), false);
        assert!(all.found.is_empty() && all.idle == [fault.clone()], "{all:?}");
        let any = simulator.seeds((1, 20), Some(&[fault.clone(), drift.clone()]), &mut |_, _| ());
        assert_eq!(any.idle, [fault], "the clock was wrong in each run");
    }
    // Without faults the run goes on until nothing can happen any more.
    assert_eq!(simulator.schedule(&Schedule::default(), false).ended[Ended::Over as usize], 1);
}

/// If a fault is left out of a schedule, the choices of the other choosers do not shift.
#[test]
fn each_chooser_has_choices_of_its_own() {
    let cell = Text::new(ASKS);
    let simulator = simulator(&cell.plan, 1_000);
    let lose = Fault::Lose { link: (node(0), node(1)), nth: 3 };
    let charts = [&[lose][..], &[]].map(|faults| simulator.chart_of_seed(5, Some(faults)));
    let ends = |chart: &String| -> Vec<String> {
        chart.lines().filter(|line| line.contains("go ends")).map(str::to_owned).collect()
    };
    let [lost, plain] = charts.each_ref().map(ends);
    assert!(plain.len() == 3 && lost[..2] == plain[..2], "{}\n{}", charts[0], charts[1]);
    let task = TaskId::from_index(0);
    // An action of 5 to 9 ticks ends at any of five instants: after its least time, or after its most time less 3, 2, 1 or
    // 0 ticks.
    let instants: Vec<u64> = (0..=5)
        .map(|choice| {
            let tape = Tape::from([(Chooser::Task(task), vec![choice])]);
            let all = simulator.schedule(&Schedule { faults: Vec::new(), tape }, false);
            assert_eq!(all.ended[Ended::Over as usize], 1, "{all:?}");
            all.ticks
        })
        .collect();
    let least = instants[0];
    assert_eq!(instants, [0, 1, 2, 3, 4, 4].map(|more| least + more), "a number past the last is the last");
}
