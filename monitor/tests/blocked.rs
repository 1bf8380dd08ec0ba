//! Tests of the banner: every screen names what blocks the cell, neither too early nor too strikingly.

use crate::common::crowd::CROWD_DEATH;
use crate::common::{BEAT, LIFT, Stage, at, beam, left, ms, snapshot};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::{Msg, Screen};
use imrs_monitor::source::Feed;
use imrs_monitor::store::blocked::{Blocker, Kind, blockers};
use imrs_monitor::store::health::findings;
use imrs_monitor::store::journal::Severity;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, MeetingState, TaskId, TaskState, Ticks};
use imrs_wire::obs::{Liveness, ServerFrame};
use std::time::Duration;

const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];

fn blocked(stage: &Stage, now: Duration) -> Vec<Blocker> {
    blockers(stage.app.store(), &beam(), now)
}

/// The second line of the screen, which is the banner.
fn banner(stage: &Stage, now: Duration, width: u16) -> String {
    stage.text(now, width, 24).lines().nth(1).unwrap_or_default().to_owned()
}

/// At the time 1 s, both arms have waited for the hoist for as long as `waited`.
fn waiting(waited: Duration) -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    for node in 0..2 {
        let mut after = snapshot(node);
        let patience = Ticks(1_000_000 - waited.as_micros() as u64);
        after.tasks[0].view.meetings[0].remaining = Some(patience);
        stage.frame(ms(1_000), node, ServerFrame::Snapshot(after));
    }
    stage
}

#[test]
fn a_wait_is_shown_after_half_a_second_and_alarms_when_it_is_longer_than_usual() {
    let stage = waiting(ms(100));
    assert_eq!(blocked(&stage, ms(1_300)), []);
    assert_eq!(banner(&stage, ms(1_300), 120), " no single blocker");
    let found = blocked(&stage, ms(1_450));
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].kind, found[0].level), (Kind::Awaited, Severity::Note));
    assert_eq!(found[0].by, [TaskId(0), TaskId(1)]);
    let shown = banner(&stage, ms(1_450), 120);
    assert!(shown.starts_with(" waiting for hoist@nh - receive halt - holds 2 of 3 for 5"), "{shown}");
    // If no rounds were observed, a wait counts as too long after three quarters of its time_out.
    let shown = banner(&stage, ms(1_700), 120);
    assert!(shown.starts_with(" BLOCKED BY hoist@nh - receive halt - holds 2 of 3 for 80"), "{shown}");
}

#[test]
fn the_usual_time_of_a_meeting_is_that_of_its_own_rounds() {
    let mut stage = waiting(ms(100));
    for round in 0..6 {
        for (node, after) in [(0, 0), (1, 10), (2, 550)] {
            let start = 100 * u64::from(round);
            let reached = left(Event::Reached, LIFT, node, round, 1_000);
            let released = left(Event::ReleasedComplete, LIFT, node, round, 400);
            let list = [(start + after, reached), (start + 560, released)];
            stage.frame(ms(1_000), node.into(), ServerFrame::Events(at(node.into(), &list)));
        }
    }
    let found = blocked(&stage, ms(1_450));
    let usual = found[0].usual_us.expect("six rounds");
    assert!((500_000..600_000).contains(&usual), "{usual}");
    assert_eq!(found[0].level, Severity::Note);
    let late = ms(1_000) + Duration::from_micros(usual) - ms(100) + ms(5);
    assert_eq!(blocked(&stage, late)[0].level, Severity::Warn);
    let shown = banner(&stage, late, 120);
    assert!(shown.starts_with(" BLOCKED BY hoist@nh") && shown.contains(", p99 5"), "{shown}");
}

#[test]
fn a_dead_node_is_named_half_a_second_after_its_death_and_not_the_ones_that_may_still_come() {
    let mut stage = waiting(ms(700));
    // The right arm has not arrived either, but it can still arrive.
    let mut right = snapshot(1);
    right.tasks[0].view.state = TaskState::Running;
    right.tasks[0].view.meetings[0].state = MeetingState::Away;
    stage.frame(ms(1_000), 1, ServerFrame::Snapshot(right));
    let mut arm = snapshot(0);
    arm.tasks[0].view.meetings[0].members[1].arrived = false;
    stage.frame(ms(1_000), 0, ServerFrame::Snapshot(arm));
    stage.lose(ms(1_100), 2);
    assert!(!banner(&stage, ms(1_500), 120).contains("DEAD"));
    let shown = banner(&stage, ms(10_200), 120);
    assert!(shown.starts_with(" BLOCKED BY hoist@nh - DEAD 9s - holds 1 of 3"), "{shown}");
    assert!(!shown.contains("armR@nr"), "{shown}");
}

/// Several tasks are named together only if what the banner says of the first one holds for all of them. Otherwise the
/// others are counted.
#[test]
fn tasks_in_different_states_are_not_named_together() {
    let mut stage = Stage::cell(Theme::ASCII);
    for node in 1..3 {
        let mut away = snapshot(node);
        away.tasks[0].view.state = TaskState::Running;
        away.tasks[0].view.meetings[0].state = MeetingState::Away;
        stage.frame(ms(1_000), node, ServerFrame::Snapshot(away));
    }
    let mut arm = snapshot(0);
    arm.tasks[0].view.meetings[0].members[1].arrived = false;
    arm.tasks[0].view.meetings[0].remaining = Some(Ticks(300_000));
    stage.frame(ms(1_000), 0, ServerFrame::Snapshot(arm));
    let shown = banner(&stage, ms(1_100), 160);
    assert!(shown.contains(" armR@nr, hoist@nh - run - holds 1 of 3"), "{shown}");
    let mut hoist = snapshot(2);
    hoist.tasks[0].view.meetings[0].state = MeetingState::Away;
    stage.frame(ms(1_050), 2, ServerFrame::Snapshot(hoist));
    let shown = banner(&stage, ms(1_100), 160);
    assert!(shown.contains(" armR@nr - run, +1 other - holds 1 of 3"), "{shown}");
    assert!(!shown.contains("hoist"), "{shown}");
}

#[test]
fn a_dead_node_for_which_no_task_waits_is_named_too() {
    let mut stage = Stage::cell(Theme::ASCII);
    for node in 0..2 {
        let mut after = snapshot(node);
        after.tasks[0].view.state = TaskState::Running;
        after.tasks[0].view.meetings[0].state = MeetingState::Away;
        after.tasks[0].view.meetings[0].remaining = None;
        stage.frame(ms(1_000), node, ServerFrame::Snapshot(after));
    }
    stage.lose(ms(1_100), 2);
    assert_eq!(banner(&stage, ms(3_200), 80), " LOST nh - DEAD 2s - holds no task now  b: go there");
    let mut crashed = Stage::cell(Theme::ASCII);
    let mut after = snapshot(0);
    after.tasks[0].liveness = Liveness::Crashed;
    crashed.frame(ms(1_000), 0, ServerFrame::Snapshot(after));
    let names: Vec<_> = blocked(&crashed, ms(1_700)).into_iter().map(|b| (b.kind, b.name)).collect();
    assert!(names.contains(&(Kind::Lost, "armL@nl".to_owned())), "{names:?}");
    // A node that has said goodbye is named as a block only if a task waits for it.
    crashed.feed(ms(1_000), 7, Feed::Stale { cell: "beam-lift".into(), node: "nx".into() });
    assert!(blocked(&crashed, ms(1_700)).iter().all(|b| b.name != "nx"));
}

#[test]
fn a_cycle_is_named_as_a_cycle() {
    let mut stage = Stage::cell(Theme::ASCII);
    let mut left = snapshot(0);
    left.tasks[0].view.meetings[0].members[1].arrived = false;
    stage.frame(ms(3_000), 0, ServerFrame::Snapshot(left));
    let mut right = snapshot(1);
    let view = &mut right.tasks[0].view;
    view.state = TaskState::Receiving { port: Some(BEAT), remaining: None };
    view.meetings[0].state = MeetingState::Away;
    let beat = view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    (beat.len, beat.min_slack) = (0, None);
    beat.queue.clear();
    stage.frame(ms(3_000), 1, ServerFrame::Snapshot(right));
    stage.frame(ms(3_000), 2, ServerFrame::Snapshot(snapshot(2)));
    let shown = banner(&stage, ms(3_050), 120);
    assert!(shown.starts_with(" WAIT CYCLE armL@nl, armR@nr - only a time_out ends it"), "{shown}");
}

/// The keys to every screen, to a selected title, and to lines that are typed.
const EVERYWHERE: [&str; 16] =
    ["1", "2l", "2l\n", "3", "4", "5", "6", "7", "8", "8x", "?", "o", "6o", "1:po", "6/exp", "1/armL\n"];

/// The same in a cell of twelve nodes and 108 ports, of which none waits for the dead one.
#[test]
fn ten_seconds_after_a_death_every_screen_of_a_large_cell_names_it() {
    let stage = Stage::crowd_for(Theme::MONO, 152);
    for (width, height) in SIZES {
        for keys in EVERYWHERE {
            let mut stage = Stage { app: stage.app.clone() };
            stage.typed(CROWD_DEATH, (width, height), keys);
            let shown = stage.text(CROWD_DEATH + ms(10_000), width, height);
            let named = |line: &str| line.contains("LOST node3") && line.contains("DEAD 10s");
            assert!(shown.lines().any(named), "{keys} at {width}x{height}: {shown}");
        }
    }
}

/// Ten seconds after a death, whichever screen is shown at whichever size: the culprit and its state are in words.
#[test]
fn ten_seconds_after_a_death_every_screen_names_the_culprit() {
    let dead = ms(1_500);
    for theme in Theme::ALL {
        for (width, height) in SIZES {
            for keys in EVERYWHERE {
                let mut stage = Stage::busy(theme);
                stage.lose(dead, 2);
                stage.typed(dead, (width, height), keys);
                let shown = stage.text(dead + ms(10_000), width, height);
                let named = |line: &str| line.contains("BLOCKED BY hoist@nh") && line.contains("DEAD 10s");
                assert!(shown.lines().any(named), "{keys} at {width}x{height}: {shown}");
            }
        }
    }
}

#[test]
fn a_key_and_a_click_lead_to_the_culprit() {
    let place = |stage: &Stage| {
        let rows = stage.app.rows(&[], ms(3_000));
        let row = rows[stage.app.selected(&rows)];
        (stage.app.screen, row.place.task)
    };
    let hoist = (Screen::Overview, Some(TaskId(2)));
    for keys in ["3b", "5b", "7b", "6b", "4b", "1b"] {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.lose(ms(1_500), 2);
        stage.typed(ms(3_000), (80, 24), keys);
        assert_eq!(place(&stage), hoist, "{keys}");
    }
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_500), 2);
    // The row is hidden, first by the filter, then by a closed node.
    stage.typed(ms(3_000), (80, 24), "/armL\n6");
    let kind = MouseEventKind::Down(MouseButton::Left);
    stage
        .app
        .update(Msg::Mouse(MouseEvent { kind, column: 5, row: 1, modifiers: KeyModifiers::NONE }), ms(3_000));
    assert_eq!(place(&stage), hoist);
    assert_eq!(stage.app.filter(), "");
    stage.key(ms(3_000), KeyCode::Left);
    stage.key(ms(3_000), KeyCode::Left);
    assert_eq!(place(&stage).1, None, "the node is folded");
    stage.keys(ms(3_000), "b");
    assert_eq!(place(&stage), hoist);
    let mut calm = waiting(ms(100));
    calm.keys(ms(1_200), "3b");
    assert_eq!(calm.app.screen, Screen::Rendezvous);
    assert!(calm.text(ms(1_200), 80, 24).lines().last().unwrap().contains("no single blocker"));
}

#[test]
fn the_rows_of_the_culprit_are_the_loudest_and_the_held_tasks_are_only_warned_of() {
    let mut stage = Stage::busy(Theme::COLOUR);
    stage.lose(ms(1_500), 2);
    let buffer = stage.draw(ms(3_000), 120, 40);
    let shown = crate::common::text(&buffer);
    let row = |word: &str| -> u16 {
        shown.lines().position(|l| l.trim_start().starts_with(&format!("▾ {word}"))).unwrap() as u16
    };
    let alarm = Theme::COLOUR.style(imrs_monitor::theme::Ink::Alarm);
    let is_alarm = |y: u16, x: u16| {
        let cell = &buffer[(x, y)];
        (cell.fg, cell.bg) == (alarm.fg.unwrap(), alarm.bg.unwrap())
    };
    // The row of the dead node and that of its task are in the alarm's colours from the first column to the last.
    let dead = shown.lines().position(|line| line.trim_start().starts_with("✗ nh")).unwrap() as u16;
    for y in [dead, row("hoist")] {
        assert!((0..120).all(|x| is_alarm(y, x)), "{y}: {shown}");
    }
    let warn = Theme::COLOUR.style(imrs_monitor::theme::Ink::Warn).fg.unwrap();
    for arm in ["armL", "armR"] {
        let y = row(arm);
        assert!((0..120).all(|x| !is_alarm(y, x)), "{arm}: {shown}");
        let end = shown.lines().nth(y.into()).unwrap().find("waitfor").unwrap() as u16;
        let text = (6..end + 7).filter(|x| buffer[(*x, y)].symbol() != " ");
        assert!(
            text.clone().count() > 8 && text.clone().all(|x| buffer[(x, y)].fg == warn),
            "{arm}: {shown}"
        );
    }
    assert!(shown.lines().nth(row("hoist").into()).unwrap().contains("!! holds 2 of 3"), "{shown}");
}

#[test]
fn what_follows_from_a_block_is_told_apart_from_its_cause() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_500), 2);
    let now = ms(3_000);
    let found = findings(stage.app.store(), &beam(), now);
    let blocked = blocked(&stage, now);
    let caused = |code: &str| {
        let of: Vec<_> = found.iter().filter(|f| f.code == code).collect();
        assert!(!of.is_empty(), "{code}: {found:?}");
        of.iter().all(|f| blocked.iter().any(|b| b.explains(f)))
    };
    assert!(caused("rendezvous-lost-member"));
    assert!(!caused("node-dead"));
    let foot = stage.text(now, 120, 24).lines().last().unwrap().to_owned();
    assert!(foot.starts_with(" !! nh: dead"), "{foot}");
}
