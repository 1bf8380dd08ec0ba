//! Tests of the timeline's rows: their times, and the lanes that have no room.

use crate::common::crowd::CROWD_NOW;
use crate::common::{BEAT, HALT, LIFT, Stage, at, beam, events, left, ms, observed, snapshot};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::store::message::{MessageKey, stages_of};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, TaskId};
use imrs_wire::obs::{Pong, ServerFrame};
use proptest::prelude::*;
use std::time::Duration;

const NOW: Duration = ms(1_100);

/// The times of the rows in microseconds, as text on the screen.
fn times(shown: &str) -> Vec<i64> {
    let time = |line: &str| {
        let text = line.get(1..10)?.trim().to_owned();
        let (minutes, seconds) = text.strip_prefix('-').unwrap_or(&text).split_once(':')?;
        let us =
            minutes.parse::<i64>().ok()? * 60_000 + (seconds.parse::<f64>().ok()? * 1_000.0).round() as i64;
        Some(if text.starts_with('-') { -us } else { us })
    };
    shown.lines().skip(2).filter_map(time).collect()
}

/// The left arm's node restarts. Rows of its earlier events have times before its start, and every row has a time.
#[test]
fn after_a_restart_times_go_on_and_are_negative_before_it() {
    let mut stage = Stage::cell(Theme::ASCII);
    let sent = |n: u64| (4_700 + 50 * n, left(Event::Sent, BEAT, 1, u32::try_from(n).unwrap(), 200));
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &[sent(0), sent(1), sent(2)])));
    stage.lose(ms(1_020), 0);
    stage.attach(ms(1_500), 0, 2);
    // The new incarnation started 400 ms before the snapshot, which was taken at 5,500 ms of the same clock.
    let mut restarted = snapshot(0);
    (restarted.mono_us, restarted.uptime_us) = (5_500_000, 400_000);
    stage.frame(ms(1_500), 0, ServerFrame::Snapshot(restarted));
    stage.frame(ms(1_500), 0, ServerFrame::Pong(Pong { echo_us: 1_500_000, mono_us: 5_500_000 }));
    let again = [(5_200, left(Event::Sent, BEAT, 1, 0, 200)), (5_300, left(Event::Sent, BEAT, 1, 1, 200))];
    stage.frame(ms(1_500), 0, ServerFrame::Events(at(0, &again)));
    let shown = stage.typed(ms(1_600), (120, 40), "4");
    assert_eq!(times(&shown), [-400, -350, -300, 100, 200], "{shown}");
}

proptest! {
    /// For any events with any clocks, and for any selected lane, no row's time is before the time of the row above.
    #[test]
    fn times_never_run_backwards(
        said in prop::collection::vec((0..3_usize, 0..8_usize, 0..3_u32, 0..9_u64), 1..30),
        ahead in prop::array::uniform3(0..200_u64),
        lane in 0..3_usize,
    ) {
        let kinds = [
            Event::Sent, Event::Delivered, Event::Replied, Event::Answered, Event::Reached, Event::PartnerArrived,
            Event::Confirmed, Event::ReleasedByConfirm,
        ];
        let mut stage = Stage::cell(Theme::ASCII);
        let mut clock = [4_000_u64; 3];
        for (node, kind, number, passed) in said {
            clock[node] += passed * 17;
            let peer = u16::try_from((node + 1) % 3).unwrap();
            let event = [(clock[node] + ahead[node], left(kinds[kind], BEAT, peer, number, 10))];
            stage.frame(ms(1_000), node, ServerFrame::Events(at(node, &event)));
        }
        stage.keys(NOW, &("4".to_owned() + &"l".repeat(lane)));
        let times = times(&stage.text(NOW, 120, 60));
        prop_assert!(times.is_sorted(), "{times:?}");
    }
}

/// The monitor compared the nodes' clocks over a slow connection, so a request may seem to be rejected and answered before it was sent.
/// The stages of its history are in the order in which one follows from the other nevertheless.
#[test]
fn a_large_error_of_the_clocks_changes_no_order_of_a_message() {
    use Event::{Answered, Delivered, Enqueued, Rejected, Replied, Resent, Sent};
    let mut stage = Stage::cell(Theme::ASCII);
    // The answer came when the left arm's clock was 300 ms behind that of the right arm.
    let here = [(4_000, Sent), (4_040, Resent), (4_060, Answered)];
    let there = [(4_310, Rejected), (4_345, Enqueued), (4_350, Delivered), (4_355, Replied)];
    let of = |list: &[(u64, Event)], peer| {
        list.iter().map(|(ms, event)| (*ms, left(*event, BEAT, peer, 7, 100))).collect::<Vec<_>>()
    };
    // The monitor compares its clock with the node's by a ping and its answer. Here the answer came 400 ms after the ping.
    for node in [0, 1] {
        stage.frame(ms(900), node, ServerFrame::Pong(Pong { echo_us: 500_000, mono_us: 4_700_000 }));
    }
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &of(&here, 1))));
    stage.frame(ms(1_000), 1, ServerFrame::Events(at(1, &of(&there, 0))));
    let key = MessageKey { source: TaskId(0), port: BEAT, number: 7, incarnation: None };
    let stages = stages_of(stage.app.store(), &beam(), key);
    let order: Vec<_> = stages.iter().map(|stage| stage.mark.seen.what.event).collect();
    let place = |event| order.iter().position(|one| *one == event).unwrap();
    let expected = [Sent, Rejected, Enqueued, Delivered, Replied, Answered];
    assert!(expected.map(place).is_sorted(), "{order:?}");
}

/// A source numbers its messages anew after a restart. Two messages with one number have two histories, and each row
/// opens the history of its own message.
#[test]
fn after_a_restart_a_number_names_another_message() {
    use Event::{Delivered, Enqueued, Replied, Sent, TimedOut};
    let mut stage = Stage::cell(Theme::ASCII);
    let of = |list: &[(u64, Event, u64)], peer| {
        list.iter().map(|(ms, event, rest)| (*ms, left(*event, BEAT, peer, 7, *rest))).collect::<Vec<_>>()
    };
    let first = [(4_300, Sent, 200), (4_340, TimedOut, 0)];
    let taken = [(4_310, Enqueued, 190), (4_320, Delivered, 180), (4_330, Replied, 170)];
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &of(&first, 1))));
    stage.frame(ms(1_000), 1, ServerFrame::Events(at(1, &of(&taken, 0))));
    stage.lose(ms(1_020), 0);
    stage.attach(ms(1_500), 0, 2);
    let mut restarted = snapshot(0);
    (restarted.mono_us, restarted.uptime_us) = (5_500_000, 400_000);
    stage.frame(ms(1_500), 0, ServerFrame::Snapshot(restarted));
    stage.frame(ms(1_500), 0, ServerFrame::Events(at(0, &of(&[(5_200, Sent, 200)], 1))));
    stage.frame(ms(1_500), 1, ServerFrame::Events(at(1, &of(&[(5_210, Enqueued, 188)], 0))));
    let history = ["sent", "enqueued", "delivered", "replied", "timed out"];
    // The newest row of the timeline, the row of the time-out, and the same time-out among the events.
    for (keys, stages) in [("4\n", &history[..2]), ("4kk\n", &history), ("6/timed\n\n", &history)] {
        let shown = stage.typed(ms(1_600), (160, 40), keys);
        let rows: Vec<_> = shown.lines().filter(|line| line.ends_with(']')).collect();
        assert_eq!(rows.len(), stages.len(), "{keys}: {shown}");
        for (row, stage) in rows.iter().zip(stages) {
            assert!(row.contains(stage), "{keys}: {shown}");
        }
        stage.key(ms(1_600), KeyCode::Esc);
    }
}

/// Confirmations of a round are repeated. A repetition that comes after the release is not its cause.
#[test]
fn a_later_repetition_is_no_cause() {
    let mut stage = Stage::cell(Theme::ASCII);
    let confirms: Vec<_> =
        (0..6).map(|n| (4_800 + 20 * n, left(Event::Confirmed, LIFT, 0, 12, 100))).collect();
    stage.frame(ms(1_000), 1, ServerFrame::Events(at(1, &confirms)));
    let released = [(4_811, left(Event::ReleasedByConfirm, LIFT, 0, 12, 100))];
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &released)));
    let marks = stage.app.chart().timeline.marks;
    let release = marks.iter().find(|mark| mark.seen.what.event == Event::ReleasedByConfirm).unwrap();
    assert_eq!(marks[release.cause.unwrap()].seen.mono_us, 4_800_000);
    assert_eq!(release.order, release.at);
}

#[test]
fn lanes_that_do_not_fit_are_counted_and_their_rows_say_what_happened() {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.frame(ms(1_000), 0, ServerFrame::Events(events(0, &[observed(Event::Sent, BEAT, 1, 7)])));
    stage.frame(ms(1_000), 2, ServerFrame::Events(events(2, &[observed(Event::Reached, LIFT, 2, 12)])));
    // The right arm is the busiest, so that the hoist has no room.
    let busy = [observed(Event::Sent, HALT, 0, 1), observed(Event::Sent, HALT, 0, 2)];
    stage.frame(ms(1_000), 1, ServerFrame::Events(events(1, &busy)));
    let shown = stage.typed(NOW, (60, 24), "4");
    let heads = shown.lines().find(|line| line.contains("TIME")).unwrap();
    assert!(heads.contains(">armL@nl") && heads.ends_with(">1"), "{heads}");
    assert!(shown.lines().any(|line| line.ends_with("hoist: * lift r12 reached >")), "{shown}");
    stage.key(NOW, KeyCode::Right);
    let shown = stage.typed(NOW, (60, 24), "l");
    let heads = shown.lines().skip(2).find(|line| line.contains("hoist")).unwrap();
    assert!(heads.starts_with("1<"), "{heads}");
    assert!(shown.lines().any(|line| line.contains("< armL: beat#7 > armR")), "{shown}");
}

fn click(stage: &mut Stage, column: usize, row: usize) {
    let (column, row) = (u16::try_from(column).unwrap(), u16::try_from(row).unwrap());
    let kind = MouseEventKind::Down(MouseButton::Left);
    stage.app.update(Msg::Mouse(MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE }), NOW);
}

/// Rows with events only in lanes without room are combined into one row. If one of the events is bad, the row names it.
#[test]
fn what_happens_in_hidden_lanes_takes_one_row() {
    let mut stage = Stage::cell(Theme::ASCII);
    let sent = |n: u64| (4_700 + n, left(Event::Sent, HALT, 0, u32::try_from(n).unwrap(), 100));
    let many: Vec<_> = (0..12).map(sent).collect();
    stage.frame(ms(1_000), 2, ServerFrame::Events(at(2, &many)));
    let twice: Vec<_> = (0..20).map(|n| (4_900 + n, left(Event::Sent, BEAT, 1, 7, 200))).collect();
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &twice)));
    let once: Vec<_> = (0..20).map(|n| (4_950 + n, left(Event::Sent, HALT, 0, 7, 200))).collect();
    stage.frame(ms(1_000), 1, ServerFrame::Events(at(1, &once)));
    let shown = stage.typed(NOW, (60, 50), "4");
    assert!(shown.lines().any(|line| line.ends_with("+12 elsewhere >")), "{shown}");
    assert!(!shown.contains("hoist:"), "{shown}");
    let bad = [sent(12), (4_713, left(Event::TimedOut, HALT, 0, 13, 0)), sent(14)];
    stage.frame(ms(1_000), 2, ServerFrame::Events(at(2, &bad)));
    let shown = stage.typed(NOW, (60, 50), "4");
    assert!(shown.contains("+15 elsewhere, hoist: x halt#13 timed out >"), "{shown}");
    // If a lane further to the right is selected, the hidden lanes are to the left.
    stage.key(NOW, KeyCode::Right);
    let shown = stage.typed(NOW, (60, 50), "l");
    assert!(shown.contains("< +20 elsewhere"), "{shown}");
}

#[test]
fn the_busiest_lanes_are_shown_first() {
    let mut stage = Stage::crowd(Theme::ASCII);
    let shown = stage.typed(CROWD_NOW, (120, 30), "4");
    let heads = shown.lines().find(|line| line.contains("TIME")).unwrap();
    for task in ["task3@node1", "task15@node5", "task24@node8"] {
        assert!(heads.contains(task), "{heads}");
    }
    assert!(heads.ends_with(">32"), "{heads}");
    // All lanes have room, so they are in the order of the cell.
    let mut stage = Stage::busy(Theme::ASCII);
    let shown = stage.typed(NOW, (120, 30), "4");
    let heads = shown.lines().find(|line| line.contains("TIME")).unwrap();
    assert!(heads.find("armL").unwrap() < heads.find("hoist").unwrap(), "{heads}");
}

/// A row with visible events says how many more events are in hidden lanes, and on which side.
#[test]
fn a_row_marks_the_events_in_hidden_lanes() {
    let mut stage = Stage::cell(Theme::ASCII);
    for node in 0..3 {
        let one = [(4_900, left(Event::Reached, LIFT, 0, 12, 200))];
        stage.frame(ms(1_000), node, ServerFrame::Events(at(node, &one)));
    }
    let shown = stage.typed(NOW, (60, 24), "4-----");
    assert!(shown.lines().any(|line| line.contains("lift r12") && line.ends_with("+1>")), "{shown}");
}

#[test]
fn a_click_selects_a_lane_and_a_row_and_a_second_one_opens_the_message() {
    let mut stage = Stage::busy(Theme::ASCII);
    let shown = stage.typed(NOW, (120, 40), "4");
    let row = shown.lines().position(|line| line.contains("TIME")).unwrap();
    let column = shown.lines().nth(row).unwrap().find("armR@nr").unwrap();
    click(&mut stage, column, row);
    let shown = stage.typed(NOW, (120, 40), "");
    assert!(shown.lines().nth(row).unwrap().contains(">armR@nr"), "{shown}");
    let row = shown.lines().position(|line| line.contains("beat#8810 taken")).unwrap();
    click(&mut stage, 60, row);
    stage.draw(NOW, 120, 40);
    let chart = stage.app.chart();
    assert!(chart.held && chart.mark(chart.bottom).unwrap().seen.what.event == Event::Delivered);
    let shown = stage.typed(NOW, (120, 40), "");
    let row = shown.lines().position(|line| line.contains("beat#8810 taken")).unwrap();
    click(&mut stage, 60, row);
    assert_eq!(stage.app.message().map(|key| key.number), Some(8_810));
}
