//! Tests of standstills: tasks that go on for ever without progress are reported, and no other tasks are.

use crate::cells::{Text, within};
use crate::faulty_cells::right;
use imrs_model::cell::{CellFaults, CellMove, Kind, Times, Verdicts};
use imrs_protocol::NodeId;

const ZONES: &str = include_str!("../../examples/faulty/robots_poll_for_each_others_zone.cell");

/// The faulty cell with its wrong lines corrected: both tasks take the left zone first.
fn in_order() -> String {
    right(ZONES).expect("it says what is right")
}

fn checked(text: &str, change: impl FnOnce(&mut Text)) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    cell.plan.budget = within(100_000);
    change(&mut cell);
    let verdicts = cell.check();
    assert!(verdicts.is_complete(), "{:?}", verdicts.phases);
    (cell, verdicts)
}

/// A fault hypothesis: the node of `a` may crash, and may stay down.
fn dead() -> CellFaults {
    CellFaults { crash: vec![NodeId(0)], ..CellFaults::default() }
}

fn causes(verdicts: &Verdicts) -> Vec<&str> {
    verdicts.warnings.iter().map(|warning| warning.cause.as_str()).collect()
}

#[test]
fn two_that_poll_for_what_the_other_has_are_told_at_any_times() {
    for times in [Times::Ends, Times::Between, Times::Every] {
        let (_, verdicts) = checked(ZONES, |cell| cell.plan.times = times);
        assert_eq!(
            causes(&verdicts),
            ["a and b go on for ever, and no task makes progress any more"],
            "{times:?}"
        );
        let warning = &verdicts.warnings[0];
        assert!(warning.kind == Kind::Standstill && warning.chart.contains("RESPONSE take"));
        // The path ends with one iteration of the loop, in which no action ends.
        let last = warning.moves.iter().rposition(|step| matches!(step, CellMove::Acted(..)));
        assert!(last.is_some_and(|last| last + 8 < warning.moves.len()), "{:?}", warning.moves);
    }
    let (_, verdicts) = checked(ZONES, |cell| cell.plan.everything = true);
    assert_eq!(causes(&verdicts).len(), 1, "without reductions, too");
}

#[test]
fn one_that_polls_for_what_a_dead_one_has_is_told_and_no_fault_free_run() {
    let (_, verdicts) = checked(&in_order(), |_| ());
    assert_eq!(causes(&verdicts), [""; 0], "each has its turn");
    let (cell, verdicts) = checked(&in_order(), |cell| cell.plan.faults.push(dead()));
    assert_eq!(causes(&verdicts), ["b goes on for ever, and no task makes progress any more"]);
    let warning = &verdicts.warnings[0];
    assert!(warning.moves.iter().any(|step| matches!(step, CellMove::Crash(0))));
    assert!(!warning.moves.iter().any(|step| matches!(step, CellMove::Restart(_))), "it stays down");
    assert_eq!(cell.place(warning).map(|(line, _)| line), Some(76), "where it polls");
}

/// The statements of a task that asks for ever.
const ASKS: &str = "loop query ask(1) -> ok on time_out do ok := false; end on refused do ok := false; end; delay 10 msec; end;";

/// A cell of two tasks: `a` may send `news` to `b`, and `b` may query `a`.
fn two(a: &str, b: &str) -> String {
    format!(
        "cell two; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na
  port news(n: int8) usage = send user_list = {{b}} time_out = 20 msec class = 1;
  port ask(n: int8) -> bool usage = response user_list = {{b}} time_out = 20 msec;
  var k: int8; var yes: bool;
begin
{a}
end a;
task b on nb
  use_port news(n: int8) usage = receive;
  use_port ask(n: int8) usage = query;
  var n: int8; var ok: bool;
begin
{b}
end b;
"
    )
}

#[test]
fn what_nobody_waits_for_and_what_still_changes_is_no_standstill() {
    // One task reports for ever, and the other one receives: neither asks for an answer.
    let reports = "loop send news(1); delay 10 msec; end;";
    let (_, verdicts) = checked(&two(reports, "loop receive news(n); end;"), |_| ());
    assert_eq!(causes(&verdicts), [""; 0]);
    // One task asks until the answer is `true`. The variable for the answer changes.
    let counts = "order ask > self;
  on query ask(k) do yes := not yes; response(yes); end;";
    let (_, verdicts) = checked(&two(counts, ASKS), |_| ());
    assert_eq!(causes(&verdicts), [""; 0]);
    // The same cell, except that the answer never changes.
    let never = "order ask > self;
  on query ask(k) do response(false); end;";
    let (_, verdicts) = checked(&two(never, ASKS), |_| ());
    assert_eq!(causes(&verdicts), ["b goes on for ever, and no task makes progress any more"]);
}

/// Members that give up alone for ever overflow their packed state. Then the search is incomplete, and reports no
/// standstill.
#[test]
fn meetings_that_complete_are_progress() {
    let text = |b: &str| {
        format!(
            "cell meet; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na
  port ready() usage = waitfor user_list = {{b}} time_out = 40 msec;
begin
  loop waitfor ready() on time_out do skip; end; delay 10 msec; end;
end a;
task b on nb
  use_port ready() usage = waitfor;
begin
{b}
end b;
"
        )
    };
    let comes = text("loop waitfor ready() on time_out do skip; end; delay 10 msec; end;");
    let (_, verdicts) = checked(&comes, |_| ());
    assert_eq!(causes(&verdicts), [""; 0]);
}

/// An answer or a meeting on the path to a standstill is no part of the standstill.
#[test]
fn a_task_is_named_for_what_it_does_there_and_not_for_what_it_did_before() {
    let answers = "order ask > self;
  on query ask(k) do response(false); end;
  loop send news(1); delay 10 msec; end;";
    let once = "query ask(1) -> ok on time_out do ok := false; end on refused do ok := false; end;
  loop receive news(n); end;";
    let (_, verdicts) = checked(&two(answers, once), |_| ());
    assert_eq!(causes(&verdicts), [""; 0], "it asked once, before");
    let waits = "loop receive news(n) within 20 msec on time_out do skip; end; end;";
    let (_, verdicts) = checked(&two("send news(1);", waits), |_| ());
    assert_eq!(causes(&verdicts), [""; 0], "it asks for nothing");
    let meet = |then: &str| {
        let ports = "port ready() usage = waitfor user_list = {b} time_out = 40 msec;\n  port news";
        let text = two(
            &format!("waitfor ready() on time_out do skip; end;\n{then}"),
            &format!("waitfor ready() on time_out do skip; end;\n{ASKS}"),
        );
        text.replacen("port news", ports, 1)
            .replace("use_port news", "use_port ready() usage = waitfor; use_port news")
    };
    let never = "order ask > self;
  on query ask(k) do response(false); end;";
    let (_, verdicts) = checked(&meet(never), |_| ());
    assert_eq!(causes(&verdicts), ["b goes on for ever, and no task makes progress any more"]);
}
