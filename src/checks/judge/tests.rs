//! What a run comes to by the times of what was told.

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

/// Judges changes of `a.x` and `b.y` by their times; both are false at first.
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
    // b stops being there at 300 at the latest; that it was so at 350 came too late to be all.
    let mut judge = judge(&loaded, &[(100, 1, 1), (350, 1, 1), (310, 0, 1)]);
    judge.told(NodeId(0), 10_000);
    judge.told(NodeId(1), 300);
    judge.killed(NodeId(1), 400);
    judge.gone(NodeId(1));
    // Dead it has the variables of a new life: from then on b.y does not come any more.
    assert_eq!(broken(&mut judge), [(1, 400 + 5_000 + 1_000 + READING)]);
}

fn began(task: &str, at: u64) -> Notice {
    Notice::Began { key: task.to_owned(), task: task.to_owned(), at }
}

fn ended(task: &str, at: u64) -> Notice {
    Notice::Ended { key: task.to_owned(), at }
}

/// What came of `apart` after node `m`, with `b`, was killed at 400 while a command of `b` ran, and `a.x` was true from 600 on.
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
    // Only the time counts in which the check depends on it: from when `a.x` is true.
    for (last, seconds) in [(Some(ended("b", 900)), 0.0003), (None, 0.0044)] {
        let notices: Vec<Notice> = [began("b", 200)].into_iter().chain(last).collect();
        let told = after_a_kill(&notices);
        assert_eq!(told["outcome"], "unknown", "{told}");
        assert_eq!(told["unvouched"]["seconds"], seconds, "{told}");
        assert_eq!(told["unvouched"]["why"], "the command of `b` was not confirmed to have ended");
    }
    // One that the node told of just before its death, and one that ended in time.
    assert_eq!(after_a_kill(&[began("b", 410)])["outcome"], "unknown");
    assert_eq!(after_a_kill(&[began("b", 200), ended("b", 350)])["outcome"], "held");
}

#[test]
fn a_command_without_its_guard_is_in_doubt_though_its_node_lives() {
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
