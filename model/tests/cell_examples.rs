//! The examples of the language under the checker of cells, and a cell of four tasks and six ports.

mod cells;

use cells::Text;
use imrs_model::cell::{Budget, Kind, Phase, Verdicts};

const BEAM: &str = include_str!("../../examples/beam_lift.cell");
const WELD: &str = include_str!("../../examples/weld_cell.cell");
const FOUR: &str = "cell four;
tick 1 msec;
node n1;  node n2;  node n3;
link n1 -- n2 delay 1 msec;  link n2 -- n3 delay 1 msec;  link n1 -- n3 delay 1 msec;
type Num is record n: int8; end;
task feed on n1
  port part(m: Num) usage = send message_format = Num user_list = {left} time_out = 200 msec class = 2;
  port ready() usage = waitfor user_list = {left, right} time_out = 2 sec class = 2;
  var m: Num;
begin
  loop run fetch takes 100..300 msec; waitfor ready() on time_out do abort \"alone\"; end; send part(m); end;
end feed;
task left on n2
  use_port part(m: Num) usage = receive;  use_port ready() usage = waitfor time_out = 2 sec;
  port give(m: Num) usage = send message_format = Num user_list = {right} time_out = 300 msec class = 2;
  port seen(m: Num) usage = send message_format = Num user_list = {watch} time_out = 50 msec class = 1 bounded_buffer[2];
  var m: Num;
begin
  loop waitfor ready() on time_out do abort \"alone\"; end; receive part(m); reply(); run press takes 20..40 msec; send give(m); send seen(m); end;
end left;
task right on n3
  use_port ready() usage = waitfor time_out = 2 sec;  use_port give(m: Num) usage = receive;
  port asked(m: Num) -> Num usage = response message_format = Num user_list = {watch} time_out = 50 msec class = 2;
  port full(m: Num) usage = send message_format = Num user_list = {watch} time_out = 50 msec class = 1 bounded_buffer[2];
  var m: Num;
begin
  on query asked(q) do response(m); end;
  loop waitfor ready() on time_out do abort \"alone\"; end; receive give(m); reply(); run stack takes 10..60 msec; send full(m); end;
end right;
task watch on n3
  use_port seen(m: Num) usage = receive;  use_port full(m: Num) usage = receive;
  use_port asked(m: Num) -> Num usage = query time_out = 50 msec;
  var m: Num;
begin
  loop receive full(m); query asked(m) -> m; receive seen(m); end;
end watch;
faults loss 1;
";

/// Checks a cell within so many states for each phase.
fn checked(text: &str, states: u64) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    cell.plan.budget = Budget { states, seconds: 600.0, bytes: 3 << 30 };
    let verdicts = cell.check();
    (cell, verdicts)
}

#[test]
fn the_beam_is_wound_longer_than_the_arms_wait() {
    let (cell, verdicts) =
        checked(&BEAM.replacen("tick 1 msec;", "tick 1 msec;\nmodel tick 20 msec;", 1), 20_000);
    let [fault_free, faults] = &verdicts.phases[..] else { panic!("two phases") };
    assert!(fault_free.complete && !faults.complete);
    let stranded =
        verdicts.of(Kind::Stranded).find(|f| f.task.is_some_and(|task| task.0 == 0)).expect("armL");
    assert_eq!(stranded.cause, "armL: waitfor `lift` waits in vain for hoist");
    assert!(cell.source(stranded).starts_with("waitfor lift()"));
    // armR moves before armL has begun to: not a stop, but what the check forbids.
    let stop = verdicts.of(Kind::Check).find(|finding| finding.check == Some(1)).expect("stop_both");
    assert_eq!(stop.phase, Phase::FaultFree);
    assert!(verdicts.of(Kind::Machine).next().is_none());
}

#[test]
fn the_weld_cell_is_sound_without_faults() {
    let (_, verdicts) = checked(WELD, 20_000);
    assert!(verdicts.phases[0].complete && !verdicts.phases[1].complete);
    assert_eq!(verdicts.findings.iter().filter(|finding| finding.phase == Phase::FaultFree).count(), 0);
    assert!(verdicts.of(Kind::TwoOwners).next().is_none() && verdicts.of(Kind::Machine).next().is_none());
}

#[test]
fn four_tasks_and_six_ports_are_looked_at_whole() {
    let (cell, verdicts) = checked(FOUR, 500_000);
    assert!(verdicts.is_complete());
    let found = cell.found(&verdicts);
    assert!(found.iter().all(|(kind, _)| *kind == Kind::Ends), "{found:?}");
    assert!(!found.is_empty(), "a lost packet ends whom no branch helps");
}
