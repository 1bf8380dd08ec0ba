//! Tests of the wait-for graph over every kind of wait.

use crate::common::{BEAT, HALT, LIFT, Stage, beam, events, ms, observed, snapshot};
use imrs_monitor::store::waits::{awaited, cycles, waits};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, MeetingState, TaskId, TaskState, Ticks};
use imrs_wire::obs::{ServerFrame, Snapshot};
use std::time::Duration;

/// The state of the right arm's node if that arm has not reached the lift, and is in this state instead.
fn right(state: TaskState) -> Snapshot {
    let mut right = snapshot(1);
    let view = &mut right.tasks[0].view;
    view.state = state;
    view.meetings[0].state = MeetingState::Away;
    view.meetings[0].remaining = None;
    let beat = view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    (beat.len, beat.min_slack) = (0, None);
    beat.queue.clear();
    right
}

/// The state of the left arm's node if only that arm waits for the lift.
fn left() -> Snapshot {
    let mut left = snapshot(0);
    left.tasks[0].view.meetings[0].members[1].arrived = false;
    left
}

const RECEIVES: TaskState = TaskState::Receiving { port: Some(BEAT), remaining: None };

fn stage(now: Duration, state: TaskState) -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.frame(now, 0, ServerFrame::Snapshot(left()));
    stage.frame(now, 1, ServerFrame::Snapshot(right(state)));
    stage.frame(now, 2, ServerFrame::Snapshot(snapshot(2)));
    stage
}

#[test]
fn the_one_whom_all_wait_for_is_named() {
    let stage = Stage::cell(Theme::ASCII);
    let store = stage.app.store();
    let found = awaited(store, &beam(), ms(1_050));
    let named: Vec<_> = found.iter().map(|a| (a.task, a.by.as_slice(), a.wait.why.as_str())).collect();
    assert_eq!(named, [(TaskId(2), &[TaskId(0), TaskId(1)][..], "waitfor lift")]);
    assert!(cycles(store, &beam(), ms(5_000)).is_empty(), "the hoist waits for nobody");
}

#[test]
fn a_receive_and_a_waitfor_make_a_cycle() {
    let stage = stage(ms(3_000), RECEIVES);
    let found = cycles(stage.app.store(), &beam(), ms(3_050));
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].tasks, [TaskId(0), TaskId(1)]);
    let why = ["armL waits for armR (waitfor lift)", "armR waits for armL (receive beat)"];
    assert_eq!(found[0].why, why);
}

#[test]
fn what_may_still_be_on_its_way_makes_none() {
    let mut stage = stage(ms(3_000), RECEIVES);
    let sent = events(0, &[observed(Event::Sent, BEAT, 1, 7)]);
    stage.frame(ms(3_000), 0, ServerFrame::Events(sent));
    assert!(cycles(stage.app.store(), &beam(), ms(3_050)).is_empty(), "a beat was just sent");
    let told = |stage: &mut Stage, node: usize| {
        let state = if node == 0 { left() } else { right(RECEIVES) };
        stage.frame(ms(3_450), node, ServerFrame::Snapshot(state));
    };
    told(&mut stage, 0);
    stage.frame(ms(3_450), 2, ServerFrame::Snapshot(snapshot(2)));
    let found = cycles(stage.app.store(), &beam(), ms(3_500));
    assert!(found.is_empty(), "the right arm has told nothing since: it may have taken the beat");
    told(&mut stage, 1);
    assert_eq!(cycles(stage.app.store(), &beam(), ms(3_500)).len(), 1, "the beat would have come by now");
    // The monitor cannot know what the tasks of a silent node do.
    stage.frame(ms(4_600), 0, ServerFrame::Snapshot(left()));
    stage.frame(ms(4_600), 2, ServerFrame::Snapshot(snapshot(2)));
    assert!(cycles(stage.app.store(), &beam(), ms(4_650)).is_empty(), "the right arm's node is silent");
}

#[test]
fn a_request_on_its_way_to_one_who_receives_makes_none() {
    let mut stage = stage(ms(3_000), RECEIVES);
    let mut left = snapshot(0);
    left.tasks[0].view.state =
        TaskState::AwaitingReply { port: BEAT, from: TaskId(1), remaining: Ticks(100_000) };
    left.tasks[0].view.meetings[0].state = MeetingState::Away;
    stage.frame(ms(3_000), 0, ServerFrame::Snapshot(left));
    let store = stage.app.store();
    let found = waits(store, &beam(), ms(3_050));
    let ends: Vec<_> = found.iter().map(|w| (w.waiter.0, w.on.0, w.why.as_str())).collect();
    assert_eq!(ends, [(0, 1, "reply beat"), (1, 0, "receive beat")]);
    assert!(cycles(store, &beam(), ms(3_050)).is_empty());
}

#[test]
fn two_who_both_arrived_do_not_wait_for_each_other() {
    let mut stage = Stage::cell(Theme::ASCII);
    for node in 0..2 {
        let mut deaf = snapshot(node);
        for member in &mut deaf.tasks[0].view.meetings[0].members {
            member.arrived = member.task.0 == node as u16;
        }
        stage.frame(ms(3_000), node, ServerFrame::Snapshot(deaf));
    }
    stage.frame(ms(3_000), 2, ServerFrame::Snapshot(snapshot(2)));
    let found = waits(stage.app.store(), &beam(), ms(3_050));
    assert!(found.iter().filter(|w| w.port == LIFT).all(|w| w.on == TaskId(2)), "{found:?}");
}

#[test]
fn one_of_several_senders_is_not_waited_for() {
    let any = TaskState::Receiving { port: None, remaining: None };
    let found = waits(stage(ms(3_000), any).app.store(), &beam(), ms(3_050));
    assert!(!found.iter().any(|w| w.waiter == TaskId(1)), "the hoist or the left arm may send: {found:?}");
    let halt = TaskState::Receiving { port: Some(HALT), remaining: None };
    let found = waits(stage(ms(3_000), halt).app.store(), &beam(), ms(3_050));
    assert!(found.iter().any(|w| (w.waiter, w.on) == (TaskId(1), TaskId(2))), "{found:?}");
}
