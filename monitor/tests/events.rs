//! Tests of the event log: which events share a line, which stay, and which are hidden.

use crate::common::{BEAT, HALT, LIFT, Stage, events, left, ms, observed};
use imrs_monitor::source::Feed;
use imrs_monitor::store::journal::KEPT;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Reason};
use imrs_wire::obs::{Events, ServerFrame, TimedEvent};
use std::time::Duration;

/// A node dies, and for a minute the other two nodes alternately drop a packet every hundred milliseconds.
fn flooded() -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.lose(ms(2_000), 2);
    for n in 0..600 {
        let node = usize::try_from(n % 2).unwrap();
        let dropped = observed(Event::Discarded(Reason::Expired), HALT, 2, n);
        let at = ms(2_100 + 100 * u64::from(n));
        stage.frame(at, node, ServerFrame::Events(events(node, &[dropped])));
    }
    stage
}

#[test]
fn a_flood_from_several_nodes_takes_a_line_of_each_and_the_death_before_it_stays_visible() {
    let mut stage = flooded();
    let lines = stage.app.events();
    let said: Vec<_> = lines.iter().map(|e| (e.node.raw(), e.kind(), e.times)).collect();
    assert_eq!(said[3..], [("nh", "dead", 1), ("nl", "discard", 300), ("nr", "discard", 300)]);
    let now = ms(2_100 + 60_000);
    stage.keys(now, "6");
    let shown = stage.text(now, 120, 40);
    assert!(shown.contains("x300 5.0/s, last 200ms ago: expired (with hoist, #598)"), "{shown}");
    assert!(shown.lines().any(|line| line.contains("nh") && line.contains("dead")), "{shown}");
}

/// A hundred senders whose messages expire in turn take a hundred lines, however long that goes on.
#[test]
fn a_flood_with_many_subjects_is_folded_too() {
    let mut stage = Stage::cell(Theme::ASCII);
    for n in 0..5_000_u32 {
        let dropped = observed(Event::Discarded(Reason::Expired), HALT, u16::try_from(n % 100).unwrap(), n);
        stage.frame(ms(2_000 + 10 * u64::from(n)), 0, ServerFrame::Events(events(0, &[dropped])));
    }
    let times: Vec<_> = stage.app.events().iter().skip(3).map(|e| e.times).collect();
    assert_eq!(times, [50; 100]);
}

/// If an event repeats after a pause that is longer than the window, it gets another line.
#[test]
fn a_line_ends_when_its_event_has_not_come_for_the_window() {
    let mut stage = Stage::cell(Theme::ASCII);
    let dropped = observed(Event::Discarded(Reason::Expired), HALT, 2, 1);
    for at in [2_000, 11_000, 30_000] {
        stage.frame(ms(at), 0, ServerFrame::Events(events(0, &[dropped])));
    }
    let times: Vec<_> = stage.app.events().iter().skip(3).map(|e| (e.times, e.first, e.at)).collect();
    assert_eq!(times, [(2, ms(2_000), ms(11_000)), (1, ms(30_000), ms(30_000))]);
}

#[test]
fn deaths_and_returns_keep_their_order_however_close_they_are() {
    let mut stage = Stage::cell(Theme::ASCII);
    for n in 0..3 {
        stage.lose(ms(2_000 + 200 * n), 0);
        stage.attach(ms(2_100 + 200 * n), 0, 2 + u8::try_from(n).unwrap());
    }
    let kinds: Vec<_> = stage.app.events().iter().skip(3).map(|e| e.kind()).collect();
    assert_eq!(kinds, ["dead", "restart", "dead", "restart", "dead", "restart"]);
}

/// Ten thousand different warnings follow one death and one missed rendezvous.
#[test]
fn no_number_of_warnings_evicts_a_critical_event() {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.lose(ms(2_000), 2);
    stage.frame(ms(2_000), 0, ServerFrame::Events(events(0, &[left(Event::GaveUp, LIFT, 2, 11, 0)])));
    for n in 0..10_000_u32 {
        let what = observed(Event::RefusedByPeer, BEAT, u16::try_from(n % 200).unwrap(), n);
        let event = TimedEvent { mono_us: 0, task: None, what };
        let at = ms(3_000) + Duration::from_secs(u64::from(n));
        stage.frame(at, 0, ServerFrame::Events(Events { lost: 0, events: vec![event] }));
    }
    let lines = stage.app.events();
    assert_eq!(lines.len(), KEPT + 2);
    let first: Vec<_> = lines.iter().take(3).map(|e| e.kind()).collect();
    assert_eq!(first, ["dead", "gave up", "refused"]);
}

#[test]
fn a_key_leaves_discards_out() {
    let mut stage = flooded();
    stage.feed(ms(3_000), 1, Feed::Lost { why: "the connection was closed".into() });
    stage.keys(ms(3_000), "6x");
    let kinds: Vec<_> = stage.app.events().iter().map(|e| e.kind()).collect();
    assert_eq!(kinds, ["attached", "attached", "attached", "dead", "dead"]);
    assert!(stage.text(ms(3_000), 120, 40).contains("no discards, following"));
    stage.keys(ms(3_000), "x");
    assert_eq!(stage.app.events().len(), 7);
}
