//! Tests of user actions: screens that follow messages, commands, marks and the mouse.

use crate::common::{BEAT, HALT, LIFT, Stage, at, beam, left, ms, snapshot, text, traffic};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::Endpoint;
use imrs_monitor::app::lanes::Slice;
use imrs_monitor::app::{Effect, Msg, Screen};
use imrs_monitor::rows::Sort;
use imrs_monitor::store::message::{MessageKey, Passed, stages_of};
use imrs_monitor::store::timeline::{Timeline, timeline};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Incarnation, TaskId};
use imrs_wire::obs::{Events, Pong, ServerFrame, TimedEvent};
use proptest::prelude::*;
use std::time::Duration;

const NOW: Duration = ms(1_100);

/// Whether every mark comes after its cause and after earlier marks of its task.
fn is_causal(timeline: &Timeline) -> bool {
    timeline.marks.iter().enumerate().all(|(at, mark)| {
        let earlier = timeline.marks[..at]
            .iter()
            .rev()
            .find(|m| (m.incarnation, m.task) == (mark.incarnation, mark.task));
        mark.cause.is_none_or(|cause| cause < at)
            && earlier.is_none_or(|earlier| earlier.seen.mono_us <= mark.seen.mono_us)
            && timeline.marks[..at].iter().all(|before| before.order <= mark.order)
    })
}

#[test]
fn a_message_is_followed_from_its_birth_to_the_answer() {
    let stage = Stage::busy(Theme::ASCII);
    let key = MessageKey { source: TaskId(0), port: BEAT, number: 8_810, incarnation: None };
    let stages = stages_of(stage.app.store(), &beam(), key);
    let told: Vec<_> = stages
        .iter()
        .map(|s| (s.mark.seen.what.event, s.left_us / 1_000, s.charged_us.map(|us| us / 1_000), s.passed))
        .collect();
    let passed = |ms: u64, estimated| Some(Passed { us: ms * 1_000, estimated });
    assert_eq!(
        told,
        [
            (Event::Sent, 200, None, None),
            (Event::Enqueued, 194, Some(6), passed(6, true)),
            (Event::Delivered, 170, Some(24), passed(24, false)),
            (Event::Replied, 165, Some(5), passed(5, false)),
            (Event::Answered, 158, Some(7), passed(7, true)),
        ]
    );
}

/// Each node's clock has an origin of its own. The transfer time between two nodes follows from the pings of both nodes.
#[test]
fn what_passed_between_two_nodes_is_told_by_the_clocks_of_both() {
    let mut stage = Stage::cell(Theme::ASCII);
    // The round trips take 200 and 150 us on the monitor's clock. The nodes' clocks are ahead of it by one and three hours.
    let hours = [3_600_000_000, 10_800_000_000];
    for (node, hour) in hours.into_iter().enumerate() {
        let echo_us = 1_049_800 + 50 * node as u64;
        let mono_us = hour + echo_us + (1_050_000 - echo_us) / 2;
        stage.frame(ms(1_050), node, ServerFrame::Pong(Pong { echo_us, mono_us }));
    }
    // Makes an event at this moment of the monitor's clock, with the time of the node's own clock.
    let seen = |node: usize, us: u64, what| TimedEvent {
        mono_us: hours[node] + us,
        task: Some(TaskId(node as u16)),
        what,
    };
    let there = [
        (0, seen(0, 1_010_000, left(Event::Sent, BEAT, 1, 9_000, 200))),
        (1, seen(1, 1_024_000, left(Event::Enqueued, BEAT, 0, 9_000, 186))),
        (1, seen(1, 1_025_000, left(Event::Replied, BEAT, 0, 9_000, 185))),
        (0, seen(0, 1_025_400, left(Event::Answered, BEAT, 1, 9_000, 185))),
    ];
    for (node, event) in there {
        stage.frame(ms(1_060), node, ServerFrame::Events(Events { lost: 0, events: vec![event] }));
    }
    let key = MessageKey { source: TaskId(0), port: BEAT, number: 9_000, incarnation: None };
    let passed: Vec<_> = stages_of(stage.app.store(), &beam(), key).iter().map(|s| s.passed).collect();
    let took = |us, estimated| Some(Passed { us, estimated });
    assert_eq!(passed, [None, took(14_000, true), took(1_000, false), took(400, true)]);
}

#[test]
fn no_effect_stands_above_its_cause_though_its_clock_says_so() {
    let mut stage = Stage::cell(Theme::ASCII);
    let sent = [(4_900, left(Event::Sent, BEAT, 1, 1, 200)), (4_990, left(Event::Answered, BEAT, 1, 1, 90))];
    stage.frame(ms(1_000), 0, ServerFrame::Events(at(0, &sent)));
    let taken = [
        (4_850, left(Event::Delivered, BEAT, 0, 1, 190)),
        (4_860, left(Event::Replied, BEAT, 0, 1, 180)),
        (4_870, left(Event::Reached, LIFT, 1, 12, 900)),
    ];
    stage.frame(ms(1_000), 1, ServerFrame::Events(at(1, &taken)));
    let line = timeline(stage.app.store(), &beam(), 100);
    let events: Vec<_> = line.marks.iter().map(|m| m.seen.what.event).collect();
    assert_eq!(
        events,
        [Event::Sent, Event::Delivered, Event::Replied, Event::Reached, Event::Answered],
        "fifty milliseconds apart, and still in order"
    );
    assert!(is_causal(&line));
    assert_eq!(line.marks[1].cause, Some(0));
    assert_eq!(line.marks[4].cause, Some(2));
}

proptest! {
    /// Tests any events, in any order, with any clocks.
    #[test]
    fn the_timeline_is_causal(said in prop::collection::vec((0..3_usize, 0..12_usize, 0..3_u32, 0..9_u64), 0..80)) {
        let kinds = [
            Event::Sent, Event::Resent, Event::Enqueued, Event::Delivered, Event::Replied, Event::Answered,
            Event::Reached, Event::PartnerArrived, Event::Confirmed, Event::ReleasedByConfirm, Event::GaveUp,
            Event::PartnerAborted,
        ];
        let mut stage = Stage::cell(Theme::ASCII);
        let mut clock = [4_000_u64; 3];
        for (node, kind, number, passed) in said {
            clock[node] += passed * 7;
            let peer = u16::try_from((node + 1) % 3).unwrap();
            let event = [(clock[node], left(kinds[kind], BEAT, peer, number, 10))];
            stage.frame(ms(1_000), node, ServerFrame::Events(at(node, &event)));
        }
        prop_assert!(is_causal(&timeline(stage.app.store(), &beam(), 1_000)));
        stage.keys(NOW, "4--");
        let _ = stage.text(NOW, 120, 40);
    }
}

#[test]
fn the_timeline_holds_its_place_while_more_happens() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "4");
    let rows = stage.app.chart().rows.len();
    assert!(!stage.app.chart().held);
    stage.keys(NOW, "kkk");
    let held = stage.app.chart();
    assert!(held.held && held.bottom == rows - 4);
    let more = [(5_050, left(Event::Sent, BEAT, 1, 8_900, 200))];
    stage.frame(NOW, 0, ServerFrame::Events(at(0, &more)));
    assert_eq!(stage.app.chart().bottom, rows - 4);
    assert!(stage.text(NOW, 120, 40).contains("+4 new"));
    stage.keys(NOW, "G");
    assert!(!stage.app.chart().held);
    stage.keys(NOW, "--");
    assert_eq!(stage.app.chart().zoom, Some(ms(5)));
    let quiet = |row: &Slice| matches!(row, Slice::Quiet(_));
    assert!(stage.app.chart().rows.iter().any(quiet), "long silences take one row");
    stage.keys(NOW, "+++l");
    assert_eq!((stage.app.chart().zoom, stage.app.chart().lane), (None, 1));
}

#[test]
fn lost_observations_leave_a_gap_before_what_came_after_them() {
    let stage = Stage::busy(Theme::ASCII);
    let chart = stage.app.chart();
    let lost = chart.rows.iter().position(|row| matches!(row, Slice::Lost(gap) if gap.lost == 17)).unwrap();
    let hoist = |row: &Slice| row.marks().iter().any(|&m| chart.timeline.marks[m].task == TaskId(2));
    assert_eq!(chart.rows.iter().position(hoist), Some(lost + 1));
}

#[test]
fn enter_opens_the_history_of_the_message_in_the_row_and_escape_goes_back() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "2l");
    stage.keys(NOW, "j\n");
    assert_eq!(
        stage.app.message(),
        Some(MessageKey { source: TaskId(0), port: BEAT, number: 8_813, incarnation: Some(Incarnation(1)) })
    );
    assert!(stage.text(NOW, 120, 30).contains("rejected by rank"));
    stage.keys(NOW, "?");
    stage.key(NOW, KeyCode::Esc);
    assert_eq!(stage.app.screen, Screen::Message);
    stage.key(NOW, KeyCode::Esc);
    assert_eq!(stage.app.screen, Screen::Port);
    stage.keys(NOW, "4kkk\n");
    assert_eq!(stage.app.message().map(|key| key.number), Some(8_813));
    stage.key(NOW, KeyCode::Esc);
    assert_eq!(stage.app.screen, Screen::Timeline);
    stage.keys(NOW, "6\n");
    assert_eq!(stage.app.screen, Screen::Overview, "that events were lost is of no message but of a node");
    stage.keys(NOW, "6k\n");
    assert_eq!(
        stage.app.message(),
        Some(MessageKey { source: TaskId(0), port: HALT, number: 6, incarnation: None })
    );
}

#[test]
fn the_selected_message_stays_selected_when_one_before_it_is_taken() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "2lj");
    let mut later = snapshot(1);
    let beat = later.tasks[0].view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    beat.queue.remove(0);
    beat.len -= 1;
    stage.frame(NOW, 1, ServerFrame::Snapshot(later));
    let queue = stage.app.queue(NOW);
    assert_eq!(queue[stage.app.entry(&queue)].entry.id.sequence.get(), 8_813);
    assert_eq!(stage.app.entry(&queue), 0);
}

fn command(stage: &mut Stage, text: &str) -> Effect {
    stage.keys(NOW, &format!(":{text}"));
    stage.key(NOW, KeyCode::Enter)
}

#[test]
fn commands_go_where_they_say_and_unknown_ones_name_those_there_are() {
    let mut stage = Stage::busy(Theme::ASCII);
    assert_eq!(command(&mut stage, "port beat"), Effect::Draw);
    assert!(stage.text(NOW, 120, 24).contains("beat at armR@nr"), "the end that receives");
    command(&mut stage, "port armL.halt");
    assert!(stage.text(NOW, 120, 24).contains("halt at armL@nl"));
    command(&mut stage, "node nh");
    let rows = stage.app.rows(&[], NOW);
    let place = rows[stage.app.selected(&rows)].place;
    assert_eq!(stage.app.store().incarnation(place.node.unwrap()).unwrap().node.raw(), "nh");
    assert_eq!(stage.app.screen, Screen::Overview);
    command(&mut stage, "theme mono");
    assert_eq!(stage.app.theme, Theme::MONO);
    command(&mut stage, "theme pink");
    assert!(stage.text(NOW, 200, 24).contains("there are colour, light, contrast, mono, ascii"));
    let endpoint = Endpoint::Tcp("127.0.0.1:4000".into());
    assert_eq!(command(&mut stage, "connect tcp:127.0.0.1:4000"), Effect::Connect(endpoint));
    assert_eq!(command(&mut stage, "connect nowhere"), Effect::Draw);
    assert!(stage.text(NOW, 120, 24).contains("`nowhere` names no endpoint"));
    command(&mut stage, "port none");
    assert!(stage.text(NOW, 120, 24).contains("this cell has no port none"));
    command(&mut stage, "dance");
    assert!(stage.text(NOW, 200, 24).contains("no such command; there are :connect"));
    stage.keys(NOW, "j");
    assert!(!stage.text(NOW, 200, 24).contains("no such command"), "the next key takes it away");
    assert_eq!(command(&mut stage, "quit"), Effect::Quit);
    stage.keys(NOW, ":quit");
    stage.key(NOW, KeyCode::Esc);
    assert!(stage.app.entry_line.is_none());
}

#[test]
fn a_mark_is_compared_with_what_came_after_it() {
    let mut stage = Stage::busy(Theme::ASCII);
    let expired = |stage: &Stage| {
        let text = stage.text(NOW, 200, 40);
        let row = text.lines().filter(|l| l.contains(" beat ")).nth(1).unwrap().to_owned();
        row.split_whitespace().nth(9).unwrap().to_owned()
    };
    stage.keys(NOW, "d");
    assert!(!stage.app.since_mark, "without a mark there is nothing to compare with");
    stage.keys(NOW, "m");
    let mut later = snapshot(1);
    later.tasks[0].view.ports[1].counters.expired += 5;
    stage.frame(NOW, 1, ServerFrame::Snapshot(later));
    assert_eq!(expired(&stage), "+5");
    stage.keys(NOW, "d");
    assert_eq!(expired(&stage), "5");
    stage.keys(NOW, "d");
    assert_eq!(expired(&stage), "+5");
}

#[test]
fn what_a_row_is_called_can_be_copied() {
    let mut stage = Stage::busy(Theme::ASCII);
    assert_eq!(stage.key(NOW, KeyCode::Char('y')), Effect::Copy("nl".into()));
    stage.keys(NOW, "jjj");
    assert_eq!(stage.key(NOW, KeyCode::Char('y')), Effect::Copy("nl.armL.beat".into()));
    stage.keys(NOW, "2l");
    assert_eq!(stage.key(NOW, KeyCode::Char('y')), Effect::Copy("armL.beat#8812".into()));
    assert_eq!(stage.key(NOW, KeyCode::Char('w')), Effect::Write);
}

#[test]
fn n_goes_from_one_trouble_to_the_next_or_to_what_the_filter_finds() {
    let mut stage = Stage::busy(Theme::ASCII);
    let selected = |stage: &Stage| {
        let rows = stage.app.rows(&stage.app.findings(NOW), NOW);
        stage.app.selected(&rows)
    };
    stage.keys(NOW, "n");
    let place = stage.app.rows(&stage.app.findings(NOW), NOW)[selected(&stage)].place;
    assert_eq!(place.port, Some(BEAT), "the only trouble");
    stage.keys(NOW, "g/halt\nn");
    let first = selected(&stage);
    stage.keys(NOW, "n");
    assert!(selected(&stage) > first);
    stage.keys(NOW, "N");
    assert_eq!(selected(&stage), first);
    let place = stage.app.rows(&[], NOW)[first].place;
    assert_eq!(place.port, Some(HALT));
}

fn mouse(stage: &mut Stage, kind: MouseEventKind, column: u16, row: u16) -> Effect {
    stage.app.update(Msg::Mouse(MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE }), NOW)
}

fn shown(stage: &mut Stage) -> String {
    text(&stage.draw(NOW, 120, 40))
}

#[test]
fn the_mouse_selects_opens_scrolls_and_sorts_and_can_be_off() {
    let click = MouseEventKind::Down(MouseButton::Left);
    let mut stage = Stage::busy(Theme::ASCII);
    let text = shown(&mut stage);
    let row = text.lines().position(|l| l.contains("beat") && l.contains("3/8")).unwrap();
    let row = u16::try_from(row).unwrap();
    assert_eq!(mouse(&mut stage, click, 20, row), Effect::Draw);
    let marked = shown(&mut stage);
    assert!(marked.lines().nth(row.into()).unwrap().starts_with('>'));
    mouse(&mut stage, click, 20, row);
    assert_eq!(stage.app.screen, Screen::Port, "a click on the selected row opens it");
    let text = shown(&mut stage);
    let row = u16::try_from(text.lines().position(|l| l.contains("#1.8815")).unwrap()).unwrap();
    mouse(&mut stage, click, 20, row);
    assert!(shown(&mut stage).lines().nth(row.into()).unwrap().starts_with('>'));
    mouse(&mut stage, click, 20, row);
    assert_eq!(stage.app.message().map(|key| key.number), Some(8_815));
    let tab = shown(&mut stage).lines().next().unwrap().find(" 1 ").unwrap() + 1;
    mouse(&mut stage, click, u16::try_from(tab).unwrap(), 0);
    assert_eq!(stage.app.screen, Screen::Overview);
    let title = shown(&mut stage).lines().nth(2).unwrap().find("SLACK").unwrap();
    mouse(&mut stage, click, u16::try_from(title).unwrap(), 2);
    assert_eq!((stage.app.shape.sort, stage.app.shape.inverted), (Sort::Slack, false));
    mouse(&mut stage, click, u16::try_from(title).unwrap(), 2);
    assert!(stage.app.shape.inverted);
    stage.keys(NOW, "g");
    mouse(&mut stage, MouseEventKind::ScrollDown, 0, 5);
    assert!(shown(&mut stage).lines().nth(6).unwrap().starts_with('>'));
    stage.app.mouse = false;
    assert_eq!(mouse(&mut stage, MouseEventKind::ScrollDown, 0, 5), Effect::Nothing);
}

/// The app has got no resize message, so only the drawn frame says where its rows are and how many have room.
#[test]
fn clicks_and_pages_fit_the_first_frame_whatever_its_size() {
    let click = MouseEventKind::Down(MouseButton::Left);
    let selected = |text: &str| text.lines().position(|line| line.starts_with('>'));
    for (width, height) in [(200, 60), (120, 40), (50, 10)] {
        let mut stage = Stage::busy(Theme::ASCII);
        let drawn = text(&stage.draw(NOW, width, height));
        let last = drawn.lines().collect::<Vec<_>>().iter().rposition(|line| line.contains("halt")).unwrap();
        mouse(&mut stage, click, 10, u16::try_from(last).unwrap());
        assert_eq!(selected(&text(&stage.draw(NOW, width, height))), Some(last), "{width}x{height}");
        // The help has enough lines for two screens of this height.
        stage.typed(NOW, (width, height), "?");
        stage.key(NOW, KeyCode::PageDown);
        assert!(height > 40 || stage.app.scroll == usize::from(height) - 3, "{width}x{height}");
    }
}

#[test]
fn beyond_the_end_of_a_screen_no_key_is_dead() {
    for screen in ["?", "3", "5", "7", "8x", "2l\n", "o"] {
        let mut stage = Stage::busy(Theme::ASCII);
        let end = stage.typed(NOW, (80, 9), &format!("{screen}Gjjjjjjjjjjjjjjjjjjjj"));
        assert_ne!(stage.typed(NOW, (80, 9), "k"), end, "{screen}: the first step back is seen");
    }
}

#[test]
fn with_reduced_motion_the_screen_changes_once_a_second() {
    let mut stage = Stage::busy(Theme::ASCII);
    assert_eq!(stage.app.redraw_after(), Some(ms(100)));
    stage.app.reduced_motion = true;
    assert_eq!(stage.app.redraw_after(), Some(ms(1_000)));
    let [events, ..] = traffic();
    assert_eq!(stage.frame(NOW, 0, ServerFrame::Events(events)), Effect::Nothing);
    assert_eq!(stage.key(NOW, KeyCode::Char('j')), Effect::Draw, "but at once with a key");
}

#[test]
fn only_what_waits_in_a_cycle_is_shown_where_that_is_wanted() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "3");
    assert!(stage.text(NOW, 120, 40).contains("GATHERING"));
    stage.keys(NOW, "c");
    let text = stage.text(NOW, 120, 40);
    assert!(text.contains("No wait-for cycle") && !text.contains("GATHERING"), "{text}");
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let mut stage = Stage::cell(Theme::ASCII);
    let many: Vec<_> = (0..5_000).map(|n| (4_000, left(Event::Sent, BEAT, 1, n, 1))).collect();
    for _ in 0..10 {
        stage.frame(NOW, 0, ServerFrame::Events(at(0, &many)));
    }
    for _ in 0..50_000 {
        stage.frame(NOW, 0, ServerFrame::Events(Events { lost: 1, events: Vec::new() }));
    }
    let kept: usize = stage.app.store().trail().batches().map(|batch| batch.seen.len() + 1).sum();
    assert!(kept <= imrs_monitor::store::trail::KEPT, "{kept}");
}
