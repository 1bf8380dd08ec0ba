//! Each kind of finding of a cell: the statement that it points at, and cells that have none.

mod cells;

use cells::Text;
use imrs_model::cell::{Budget, Kind, Phase, check_cell, svg};
use std::sync::Arc;

/// Two tasks on two nodes a tick apart; `a` owns what is declared in `ports`.
fn two(ports: &str, uses: &str, a: &str, b: &str, rest: &str) -> Text {
    let text = format!(
        "cell two;\ntick 1 msec;\nnode na;  node nb;\nlink na -- nb delay 1 msec;\n\
         type Num is record n: int8; end;\n\
         task a on na\n{ports}\nvar x: int8; var m: Num;\nbegin\n{a}\nend a;\n\
         task b on nb\n{uses}\nvar y: int8; var m: Num;\nbegin\n{b}\nend b;\n{rest}\n"
    );
    Text::new(&text)
}

const MEET: &str = "port meet() usage = waitfor user_list = {b} time_out = 50 msec class = 2;";
const USE_MEET: &str = "use_port meet() usage = waitfor time_out = 50 msec;";

fn kinds(text: &Text) -> Vec<(Kind, String)> {
    let verdicts = text.check();
    assert!(verdicts.is_complete());
    for finding in &verdicts.findings {
        assert!(finding.chart.lines().all(|line| line.chars().count() <= 100), "{}", finding.chart);
    }
    text.found(&verdicts)
}

fn found(kind: Kind, at: &str) -> (Kind, String) {
    (kind, at.into())
}

#[test]
fn a_healthy_meeting_has_no_findings() {
    let act = "loop run work takes 5..20 msec; waitfor meet() on time_out do skip; end; end;";
    let cell = two(MEET, USE_MEET, act, act, "");
    // The branches are for faults: without any they are never taken.
    assert_eq!(kinds(&cell), [found(Kind::Unreached, "skip"), found(Kind::Unreached, "skip")]);
    let cell = two(MEET, USE_MEET, act, act, "faults loss 2;");
    let verdicts = cell.check();
    assert_eq!(verdicts.phases.len(), 2);
    assert_eq!(cell.found(&verdicts), [found(Kind::Unreached, "skip"), found(Kind::Unreached, "skip")]);
}

#[test]
fn a_member_that_comes_too_late_strands_the_other() {
    let (a, b) = (
        "loop run work takes 5..20 msec; waitfor meet() on time_out do skip; end; end;",
        "loop run work takes 5..90 msec; waitfor meet(); end;",
    );
    let cell = two(MEET, USE_MEET, a, b, "");
    let verdicts = cell.check();
    let stranded = verdicts.of(Kind::Stranded).next().expect("stranded");
    assert_eq!(cell.source(stranded), "waitfor meet()");
    assert_eq!(stranded.cause, "a: waitfor `meet` waits in vain for b");
    assert_eq!(stranded.at_ticks, 55, "{}", stranded.chart);
    assert_eq!(verdicts.of(Kind::Ends).count(), 0, "b finds a again within its time_out");
}

#[test]
fn what_no_branch_takes_ends_the_task_under_faults() {
    let ports = "port put(m: Num) usage = send message_format = Num user_list = {b} time_out = 20 msec class = 2;";
    let uses = "use_port put(m: Num) usage = receive;";
    let cell = two(ports, uses, "loop send put(m); delay 10 msec; end;", "loop receive put(m); reply(); end;", "");
    assert!(kinds(&cell).is_empty());
}
