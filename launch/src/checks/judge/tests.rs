//! Tests of the judge: verdicts by the times of reported changes.

use super::*;
use crate::cells::{Source, load};

const CELL: &str = "cell c; tick 1 msec; node n; node m; link n -- m delay 1 msec;
task a on n var x: bool; begin loop run w takes 5 msec; x := true; end; end a;
task b on m var y: bool; begin loop run w takes 5 msec; y := true; end; end b;
check apart: never a.x and b.y;
check soon: a.x leads b.y within 5 msec;";

fn loaded() -> Loaded {
    load(&Source { name: "c.cell".into(), text: CELL.into(), paper: false }).expect("a sound cell")
}

/// A judge that has these changes of `a.x` and `b.y`, each as its time, task and new value. Both values are false at
/// first.
fn judge<'a>(loaded: &'a Loaded, changes: &[(u64, u16, i64)]) -> Judge<'a> {
    let mut judge = Judge::new(loaded, &[NodeId(0), NodeId(1)]);
    for &(at, task, value) in [(1, 0, 0), (1, 1, 0)].iter().chain(changes) {
        judge.change(Change { at, task: TaskId(task), values: vec![value] });
    }
    judge
}

fn broken(judge: &mut Judge<'_>) -> Vec<(usize, u64)> {
    judge.settle().iter().map(|broken| (broken.check, broken.at)).collect()
}

#[test]
fn changes_are_judged_in_the_order_of_their_times_once_all_have_told_them() {
    let loaded = loaded();
    let mut judge = judge(&loaded, &[(900, 1, 0), (500, 0, 1), (300, 1, 1), (1_000, 0, 0)]);
    judge.told(NodeId(0), 2_000);
    assert_eq!(broken(&mut judge), []);
    judge.told(NodeId(1), 400);
    assert_eq!(broken(&mut judge), []);
    judge.told(NodeId(1), 2_000);
    assert_eq!(broken(&mut judge), [(0, 500)]);
    assert!(judge.settlement(0).is_broken());
}

#[test]
fn what_lasts_no_longer_than_clocks_are_read_exactly_is_no_finding() {
    let loaded = loaded();
    for (until, found) in [(501, &[][..]), (502, &[(0, 500)])] {
        let mut judge = judge(&loaded, &[(400, 1, 1), (500, 0, 1), (until, 1, 0)]);
        judge.told(NodeId(0), 5_000);
        judge.told(NodeId(1), 5_000);
        assert_eq!(broken(&mut judge), found, "{until}");
    }
}

#[test]
fn what_should_come_may_be_a_tick_late_and_the_end_of_the_run_is_no_end_of_waiting() {
    let loaded = loaded();
    let late = 100 + 5_000 + 1_000 + READING;
    for (came, found) in [(late, &[][..]), (late + 1, &[(1, late)])] {
        let mut judge = judge(&loaded, &[(100, 0, 1), (200, 0, 0), (came, 1, 1)]);
        judge.all_told();
        judge.over(10_000);
        assert_eq!(broken(&mut judge), found, "{came}");
    }
    let mut judge = judge(&loaded, &[(100, 0, 1)]);
    judge.all_told();
    judge.over(late);
    assert_eq!(broken(&mut judge), []);
}

#[test]
fn after_its_last_words_nothing_is_known_of_a_killed_node_until_it_is_dead() {
    let loaded = loaded();
    // The node of `b` had reported everything before 300. The change at 350 is dropped, because other changes since 300
    // may be missing.
    let mut judge = judge(&loaded, &[(100, 1, 1), (350, 1, 1), (310, 0, 1)]);
    judge.told(NodeId(0), 10_000);
    judge.told(NodeId(1), 300);
    judge.killed(NodeId(1), 400);
    judge.gone(NodeId(1));
    // A dead task has its initial variables, so `b.y` stays false from then on.
    assert_eq!(broken(&mut judge), [(1, 400 + 5_000 + 1_000 + READING)]);
}

fn began(task: &str, at: u64) -> Notice {
    Notice::Began { key: task.to_owned(), task: task.to_owned(), at }
}

fn ended(task: &str, at: u64) -> Notice {
    Notice::Ended { key: task.to_owned(), at }
}

/// The verdict on the check `apart`. Node `m`, which runs task `b`, is killed at 400 while a command of `b` runs, and
/// `a.x` is true from 600 on.
fn after_a_kill(notices: &[Notice]) -> serde_json::Value {
    let loaded = loaded();
    let mut judge = judge(&loaded, &[(100, 1, 1), (600, 0, 1)]);
    notices.iter().for_each(|notice| judge.notice(notice.clone()));
    judge.told(NodeId(0), 10_000);
    judge.told(NodeId(1), 300);
    judge.killed(NodeId(1), 400);
    judge.gone(NodeId(1));
    judge.over(5_000);
    judge.settle();
    serde_json::to_value(judge.settlement(0)).expect("JSON")[0].clone()
}

#[test]
fn a_killed_node_is_not_dead_before_the_end_of_its_command_is_confirmed() {
    let told = after_a_kill(&[began("b", 200), ended("b", 450)]);
    assert_eq!((&told["outcome"], &told["unvouched"]), (&"held".into(), &serde_json::Value::Null), "{told}");
    // Only the time in which the check depends on `b` counts: it begins when `a.x` is true.
    for (last, seconds) in [(Some(ended("b", 900)), 0.0003), (None, 0.0044)] {
        let notices: Vec<Notice> = [began("b", 200)].into_iter().chain(last).collect();
        let told = after_a_kill(&notices);
        assert_eq!(told["outcome"], "unknown", "{told}");
        assert_eq!(told["unvouched"]["seconds"], seconds, "{told}");
        assert_eq!(told["unvouched"]["why"], "the command of `b` was not confirmed to have ended");
    }
    // In the first run the node reported a command just before its death; in the second run the command ended in time.
    assert_eq!(after_a_kill(&[began("b", 410)])["outcome"], "unknown");
    assert_eq!(after_a_kill(&[began("b", 200), ended("b", 350)])["outcome"], "held");
}

/// The verdict on the check at this position after a run.
fn settled(judge: &mut Judge<'_>, check: usize) -> serde_json::Value {
    judge.settle();
    serde_json::to_value(judge.settlement(0)).expect("JSON")[check].clone()
}

fn is_unknown(told: &serde_json::Value, seconds: f64, why: &str) {
    assert_eq!(told["outcome"], "unknown", "{told}");
    assert_eq!(
        (&told["unvouched"]["seconds"], &told["unvouched"]["why"]),
        (&seconds.into(), &why.into()),
        "{told}"
    );
}

const MEETING: &str = "cell c; tick 1 msec; node n; node m; link n -- m delay 1 msec;
task a on n port meet() usage = waitfor user_list = {b} time_out = 50 msec class = 2; var x: bool;
begin loop run w takes 5 msec; x := true; waitfor meet() on time_out do skip; end; end; end a;
task b on m use_port meet() usage = waitfor time_out = 50 msec; var y: bool;
begin loop run w takes 5 msec; y := true; waitfor meet() on time_out do skip; end; end; end b;
check met: never a.x and meet.arrived(b);
check apart: never a.x and b.y;
check meets: a.x leads meet.arrived(b) within 5 msec;";

#[test]
fn a_check_that_asks_where_a_dead_task_had_arrived_is_unknown_and_its_other_values_are_known() {
    let loaded =
        load(&Source { name: "c.cell".into(), text: MEETING.into(), paper: false }).expect("a sound cell");
    let change = |at, task: usize, flag: i64| {
        let value = |ask: &Ask| if matches!(ask, Ask::Arrived(_)) { -1 } else { flag };
        Change { at, task: TaskId::from_index(task), values: asks(&loaded)[task].iter().map(value).collect() }
    };
    // While `a.x` is false, the check `met` holds whatever `b` does.
    for (x_at, outcome) in [(600, "unknown"), (6_000, "held")] {
        let mut judge = Judge::new(&loaded, &[NodeId(0), NodeId(1)]);
        for change in [change(1, 0, 0), change(1, 1, 0), change(200, 1, 1), change(x_at, 0, 1)] {
            judge.change(change);
        }
        judge.told(NodeId(0), 10_000);
        judge.told(NodeId(1), 300);
        judge.killed(NodeId(1), 400);
        judge.gone(NodeId(1));
        judge.over(5_000);
        let met = settled(&mut judge, 0);
        assert_eq!(met["outcome"], outcome, "{met}");
        // A dead task has its initial variables.
        assert_eq!(settled(&mut judge, 1)["outcome"], "held");
        if outcome == "unknown" {
            let why = "node `m` was dead, and a value depended on it";
            is_unknown(&met, 0.0044, why);
            is_unknown(&settled(&mut judge, 2), 0.0044, why);
        }
    }
}

#[test]
fn a_node_that_could_not_tell_everything_answers_for_its_commands_and_is_known_from_its_next_change() {
    let loaded = loaded();
    let mut judge = judge(&loaded, &[(100, 0, 1), (500, 1, 0), (900, 1, 0)]);
    judge.untold(NodeId(1), 300);
    judge.notice(began("b", 90));
    judge.notice(Notice::Began { key: "next".into(), task: "b".into(), at: 600 });
    judge.all_told();
    judge.over(2_000);
    is_unknown(&settled(&mut judge, 0), 0.0002, "node `m` could not report everything");
    assert!(judge.is_missing());
}

#[test]
fn dropped_changes_leave_a_check_unknown_and_what_happened_to_nodes_and_commands_is_kept() {
    let loaded = loaded();
    // Node `n` reports nothing, so all changes of `b` wait for its report.
    let mut judge = judge(&loaded, &[]);
    judge.notice(began("b", 20));
    judge.notice(Notice::Lost { key: "b".into(), at: 50 });
    for at in 0..WAITING as u64 {
        judge.change(Change { at: 100 + at, task: TaskId(1), values: vec![0] });
    }
    let kept = judge.changes.values().filter(|event| matches!(event, Event::Command(..))).count();
    assert_eq!((kept, judge.is_missing()), (2, true));
    judge.change(Change { at: 400, task: TaskId(0), values: vec![0] });
    judge.change(Change { at: 500, task: TaskId(0), values: vec![1] });
    judge.all_told();
    judge.over(1_000);
    is_unknown(&settled(&mut judge, 0), 0.0005, "the command of `b` was not confirmed to have ended");
}

#[test]
fn a_check_whose_changes_were_dropped_never_held() {
    let loaded = loaded();
    let mut judge = judge(&loaded, &[]);
    for at in 0..WAITING as u64 {
        judge.change(Change { at: 100 + at, task: TaskId(1), values: vec![0] });
    }
    judge.change(Change { at: 400, task: TaskId(0), values: vec![0] });
    judge.all_told();
    judge.over(1_000);
    is_unknown(&settled(&mut judge, 0), 0.0, "changes came faster than they could be judged");
    let said: Vec<String> = judge.settlement(0).unjudged().collect();
    assert!(said[0].ends_with(" is unknown: changes came faster than they could be judged"), "{said:?}");
}

const ACTIVE: &str = "cell c; tick 1 msec; node n; node m; link n -- m delay 1 msec;
task a on n begin run w takes 5 msec; end a;
task b on m begin run w takes 5 msec; end b;
check alone: never a.active and b.active;";

#[test]
fn a_task_that_may_no_longer_act_does_not_answer_for_its_command() {
    let loaded =
        load(&Source { name: "c.cell".into(), text: ACTIVE.into(), paper: false }).expect("a sound cell");
    // Task `b` is not active any more from 300 on, and task `a` from 400 on.
    for (end, seconds) in [(400, None), (700, Some(0.0003))] {
        let mut judge = judge(&loaded, &[(50, 1, 1), (300, 1, 0), (400, 0, 1)]);
        judge.notice(began("b", 100));
        judge.notice(ended("b", end));
        judge.all_told();
        judge.over(1_000);
        let told = settled(&mut judge, 0);
        match seconds {
            None => assert_eq!(told["outcome"], "held", "{told}"),
            Some(seconds) => is_unknown(&told, seconds, "the command of `b` was not confirmed to have ended"),
        }
    }
}

#[test]
fn a_command_without_its_guard_is_in_doubt_though_its_node_runs() {
    let loaded = loaded();
    let mut judge = judge(&loaded, &[(100, 1, 1), (500, 1, 0), (600, 0, 1)]);
    judge.notice(began("b", 90));
    judge.notice(Notice::Lost { key: "b".into(), at: 450 });
    judge.all_told();
    judge.over(1_600);
    judge.settle();
    let told = serde_json::to_value(judge.settlement(0)).expect("JSON");
    assert_eq!((&told[0]["outcome"], &told[0]["unvouched"]["seconds"]), (&"unknown".into(), &0.001.into()));
}
