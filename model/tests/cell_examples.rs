//! The examples of the language under the checker of cells, and a cell of four tasks and six ports.

mod cells;

use cells::Text;
use imrs_model::cell::{Budget, Kind, Verdicts};

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
fn four_tasks_and_six_ports_are_looked_at_whole() {
    let (cell, verdicts) = checked(FOUR, 500_000);
    assert!(verdicts.is_complete());
    let found = cell.found(&verdicts);
    assert!(found.iter().all(|(kind, _)| *kind == Kind::Ends), "{found:?}");
    assert!(!found.is_empty(), "a lost packet ends whom no branch helps");
}

#[test]
fn any_number_of_threads_finds_the_same() {
    let text = WELD.replace("within 200 msec", "within 100 msec").replace("retry = 3 resend = 40 msec", "");
    let mut cell = Text::new(&text);
    cell.plan.budget = Budget { states: 3_000, seconds: 600.0, bytes: 3 << 30 };
    let mut told = [1, 2, 3].map(|jobs| {
        cell.plan.jobs = jobs;
        let verdicts = cell.check();
        let phases =
            verdicts.phases.iter().map(|phase| (phase.states, phase.moves, phase.depth)).collect::<Vec<_>>();
        let findings =
            verdicts.findings.into_iter().map(|finding| (finding.kind, finding.moves)).collect::<Vec<_>>();
        (phases, findings, verdicts.statements)
    });
    told.rotate_left(1);
    assert!(told[0].0.iter().any(|&(states, ..)| states >= 1_000), "{:?}", told[0].0);
    assert_eq!(told[0], told[1]);
    assert_eq!(told[0], told[2]);
}
