//! Tests of deltas, recordings and history: deltas give the same state as snapshots, and a recording may start at any time.

use crate::common::{LIFT, Stage, events, identity, ms, observed, snapshot, table, text, whole_film};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::record::Tape;
use imrs_monitor::replay::Player;
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::store::Store;
use imrs_monitor::store::conformance::{Conformance, Verdict, conformance};
use imrs_monitor::theme::Theme;
use imrs_monitor::{history, report};
use imrs_protocol::{Event, Ticks};
use imrs_wire::obs::{Delta, Detail, Pong, ServerFrame, Snapshot, Vitals};
use imrs_wire::recording::RecordingReader;
use std::fs::File;
use std::io::BufReader;
use std::sync::Arc;
use std::time::Duration;

/// The state of a node after this many periods of 100 ms.
fn state(node: usize, periods: u64) -> Snapshot {
    let mut state = snapshot(node);
    state.mono_us += periods * 100_000;
    state.uptime_us += periods * 100_000;
    for task in &mut state.tasks {
        // In two of three periods, some values change.
        task.age_us = periods % 3 * 100_000;
        for port in &mut task.view.ports {
            port.counters.sent = periods / 3;
        }
    }
    state
}

fn change(node: usize, from: u64, to: u64) -> ServerFrame {
    ServerFrame::Delta(Delta::between(&state(node, from), &state(node, to)))
}

fn whole(node: usize, at: u64) -> ServerFrame {
    ServerFrame::Delta(Delta::whole(&state(node, at)))
}

fn period(n: u64) -> Duration {
    ms(1_000 + 100 * n)
}

fn arrival(at: Duration, frame: ServerFrame) -> Arrival {
    Arrival { at, source: SourceId(0), feed: Feed::Frame(Box::new(frame)) }
}

fn attached() -> [Arrival; 2] {
    let feed = Feed::Attached { identity: identity(0, 1), pid: 800, build: "imrs 0.1.0".into() };
    [Arrival { at: ms(900), source: SourceId(0), feed }, arrival(ms(900), ServerFrame::Table(table()))]
}

/// A screen whose node is attached and has sent its first state.
fn begun(theme: Theme) -> Stage {
    let mut stage = Stage::new(theme);
    attached().into_iter().for_each(|arrival| {
        stage.feed(arrival.at, 0, arrival.feed);
    });
    stage.frame(period(0), 0, whole(0, 0));
    stage
}

#[test]
fn what_changed_is_shown_as_if_it_had_come_whole() {
    let (mut old, mut new) = (Store::default(), Store::default());
    attached().into_iter().for_each(|arrival| {
        old.apply(arrival.clone());
        new.apply(arrival);
    });
    new.apply(arrival(period(0), whole(0, 0)));
    old.apply(arrival(period(0), ServerFrame::Snapshot(state(0, 0))));
    for n in 1..60 {
        old.apply(arrival(period(n), ServerFrame::Snapshot(state(0, n))));
        new.apply(arrival(period(n), change(0, n - 1, n)));
        assert_eq!(
            new.incarnations()[0].last.as_ref().unwrap().snapshot,
            old.incarnations()[0].last.as_ref().unwrap().snapshot
        );
    }
    assert_eq!(new.gaps(), 0);
    let rate = |store: &Store| store.incarnations()[0].rate(state(0, 0).tasks[0].view.task, LIFT);
    assert!(rate(&new).is_some_and(|rate| (2.0..5.0).contains(&rate)), "{:?}", rate(&new));
    // A delta of another snapshot is not applied, and is counted.
    new.apply(arrival(period(60), change(0, 70, 71)));
    assert_eq!(new.gaps(), 1);
    assert_eq!(new.incarnations()[0].last.as_ref().unwrap().at, period(59));
    new.apply(arrival(period(61), whole(0, 61)));
    assert_eq!(*new.incarnations()[0].last.as_ref().unwrap().snapshot, state(0, 61));
}

#[test]
fn queues_the_process_and_the_clock_are_kept_by_node() {
    let mut store = Store::default();
    attached().into_iter().for_each(|arrival| store.apply(arrival));
    let vitals = Vitals { cpu_us: 7, ..Vitals::default() };
    store.apply(arrival(ms(2_000), ServerFrame::Vitals(vitals.clone())));
    store.apply(arrival(ms(2_000), ServerFrame::Detail(Detail::default())));
    store.apply(arrival(ms(2_010), ServerFrame::Pong(Pong { echo_us: 2_004_000, mono_us: 50_007_000 })));
    let incarnation = &store.incarnations()[0];
    assert_eq!(incarnation.vitals.as_ref().unwrap().what, vitals);
    let clock = incarnation.clock.unwrap();
    assert_eq!((clock.us, clock.error_us), (48_000_000, 3_000));
    // A pong with an impossible echo is ignored.
    store.apply(arrival(ms(2_020), ServerFrame::Pong(Pong { echo_us: u64::MAX, mono_us: 1 })));
    assert_eq!(store.incarnations()[0].clock, Some(clock));
}

#[test]
fn the_header_of_a_recording_says_that_a_node_runs_without_keys() {
    let folder = tempfile::tempdir().unwrap();
    for insecure in [true, false] {
        let path = folder.path().join(format!("{insecure}.imrs"));
        let tape = Tape::default();
        attached().iter().for_each(|arrival| tape.take(arrival));
        let told = Snapshot { insecure, ..state(0, 0) };
        tape.take(&arrival(period(0), ServerFrame::Delta(Delta::whole(&told))));
        tape.start(&path, period(1)).unwrap();
        tape.stop().unwrap();
        let file = File::open(&path).unwrap();
        let reader = RecordingReader::new(BufReader::new(file)).unwrap();
        assert_eq!(reader.header().insecure, insecure);
    }
}

#[test]
fn a_recording_that_begins_in_the_middle_begins_with_all_that_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.imrs");
    let (tape, mut live) = (Tape::default(), Store::default());
    let mut take = |arrival: Arrival| {
        tape.take(&arrival);
        live.apply(arrival);
    };
    attached().into_iter().for_each(&mut take);
    take(arrival(period(0), whole(0, 0)));
    (1..10).for_each(|n| take(arrival(period(n), change(0, n - 1, n))));
    tape.start(&path, period(9)).unwrap();
    // Deltas whose base is not in the recording cannot be applied. The node then sends a whole snapshot.
    (10..13).for_each(|n| take(arrival(period(n), change(0, n - 1, n))));
    take(arrival(period(13), whole(0, 13)));
    (14..40).for_each(|n| take(arrival(period(n), change(0, n - 1, n))));
    let recorded = tape.stop().unwrap();
    assert_eq!(recorded.status.lost, 0);
    let mut player = Player::new(Arc::new(whole_film(&path)), 1.0);
    assert!(player.store().incarnations()[0].last.is_none());
    player.go_to_end();
    assert_eq!(player.store().gaps(), 0);
    let [replayed, seen] =
        [player.store(), &live].map(|store| store.incarnations()[0].last.clone().unwrap().snapshot);
    assert_eq!(replayed, seen);
}

#[test]
fn while_paused_one_goes_back_in_the_present_run() {
    let mut stage = begun(Theme::MONO);
    (1..700).for_each(|n| {
        stage.frame(period(n), 0, change(0, n - 1, n));
        if n == 300 {
            let gave_up = observed(Event::GaveUp, LIFT, 2, 1);
            stage.frame(period(n), 0, ServerFrame::Events(events(0, &[gave_up])));
        }
    });
    let shown = |stage: &Stage| {
        let incarnation = &stage.app.store().incarnations()[0];
        (
            incarnation.id,
            (incarnation.last.as_ref().unwrap().snapshot.mono_us - snapshot(0).mono_us) / 100_000,
        )
    };
    let (id, _) = shown(&stage);
    let now = period(699);
    stage.keys(now, " ");
    assert_eq!(shown(&stage), (id, 699));
    stage.keys(now, "[[");
    assert_eq!(shown(&stage), (id, 697));
    assert_eq!(stage.app.moment(now), period(697));
    let screen = stage.text(now, 120, 24);
    assert!(screen.contains("PAUSED -200ms") && screen.contains("200ms before the pause"), "{screen}");
    // The nodes send more frames, but the paused screen does not show them.
    stage.frame(period(700), 0, change(0, 699, 700));
    assert_eq!(shown(&stage), (id, 697));
    stage.keys(now, "{");
    assert_eq!(shown(&stage), (id, 300), "where something went wrong");
    stage.keys(now, "]");
    assert_eq!(shown(&stage), (id, 301));
    stage.key(now, crossterm::event::KeyCode::Home);
    assert_eq!(stage.app.moment(now), ms(900));
    stage.key(now, crossterm::event::KeyCode::End);
    assert_eq!(shown(&stage), (id, 699), "the moment of the pause");
    assert!(stage.app.gone_back().is_none());
    stage.keys(now, " ");
    assert_eq!(shown(&stage), (id, 700), "and the present");
}

/// A verdict of the validator belongs to no connection, but a player that moves back still shows it at its time.
#[test]
fn the_verdict_is_known_while_one_goes_back() {
    let mut stage = begun(Theme::MONO);
    for n in 1..100 {
        stage.frame(period(n), 0, change(0, n - 1, n));
        let verdict = match n {
            0..30 => continue,
            30..70 => Verdict::Conforms,
            _ => Verdict::Violates { step: 70, what: "another queue".into() },
        };
        let said = Box::new(Conformance { verdict, steps: n });
        let (cell, node) = ("beam-lift".to_owned(), "nl".to_owned());
        stage.feed(period(n), 0, Feed::Judged { cell, node, incarnation: 1, said });
    }
    let now = period(99);
    let verdict =
        |stage: &Stage| conformance(stage.app.store(), stage.app.store().incarnations()[0].id).verdict;
    stage.keys(now, " ");
    assert!(matches!(verdict(&stage), Verdict::Violates { .. }));
    stage.keys(now, "[");
    assert!(matches!(verdict(&stage), Verdict::Violates { step: 70, .. }));
    stage.keys(now, &"[".repeat(39));
    assert_eq!((stage.app.moment(now), verdict(&stage)), (period(59), Verdict::Conforms));
    stage.keys(now, &"[".repeat(39));
    assert!(matches!(verdict(&stage), Verdict::Unknown { .. }), "before the first verdict");
    stage.keys(now, &"]".repeat(20));
    assert_eq!((stage.app.moment(now), verdict(&stage)), (period(40), Verdict::Conforms));
}

#[test]
fn the_history_is_as_long_as_it_says() {
    let (mut history, mut store) = (history::History::default(), Store::default());
    let mut take = |history: &mut history::History, arrival: Arrival| {
        history.take(&arrival, &store);
        store.apply(arrival);
    };
    attached().into_iter().for_each(|arrival| take(&mut history, arrival));
    take(&mut history, arrival(period(0), whole(0, 0)));
    for n in 1..9_000 {
        take(&mut history, arrival(period(n), change(0, n - 1, n)));
    }
    let film = history.film().unwrap();
    let kept = period(8_999) - film.stops()[0].at;
    assert!(kept >= history::LENGTH && kept < history::LENGTH + Duration::from_secs(60), "{kept:?}");
    assert!(history.weight() < 2 << 20, "{} bytes", history.weight());
    // The history begins with the state of all nodes.
    let player = Player::new(Arc::new(film), 1.0);
    let first = player.store().incarnations()[0].last.clone().unwrap().snapshot;
    assert_eq!(first.tasks[0].view.ports.len(), snapshot(0).tasks[0].view.ports.len());
    assert!(report::json(player.store(), None, player.moment()).contains("beam-lift"));
    assert_eq!(first.timers.first().map(|timer| timer.remaining), None::<Ticks>);
}

/// On a narrow screen, too, the bar says which keys move, and each of them can be clicked.
#[test]
fn the_bar_names_its_keys_at_every_width() {
    // The labels of a longer history take more of the row.
    for (now, width) in [ms(1_150), ms(21_150)]
        .into_iter()
        .flat_map(|now| [40, 59, 60, 64, 80, 99, 100, 120, 200].map(|width| (now, width)))
    {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.frame(now, 0, whole(0, 0));
        stage.key(now, KeyCode::Char(' '));
        let shown = text(&stage.draw(now, width, 12));
        let row = shown.lines().position(|line| line.contains("] ") && line.contains("{ }"));
        let row = row.unwrap_or_else(|| panic!("no keys at {width}: {shown}"));
        let line = shown.lines().nth(row).unwrap();
        assert!(line.contains("[ ]") && line.contains("space"), "{width}: {line}");
        let kind = MouseEventKind::Down(MouseButton::Left);
        let column = u16::try_from(line.rfind("[ ]").unwrap()).unwrap();
        let at = MouseEvent { kind, column, row: u16::try_from(row).unwrap(), modifiers: KeyModifiers::NONE };
        stage.app.update(Msg::Mouse(at), now);
        assert!(stage.app.gone_back().is_some(), "{width}: {line}");
    }
}

/// The row of the scrub bar on the screen, and its characters.
fn bar(stage: &mut Stage, now: Duration) -> (usize, Vec<char>) {
    let shown = text(&stage.draw(now, 100, 24));
    let row =
        shown.lines().position(|line| line.contains("{ } trouble")).unwrap_or_else(|| panic!("{shown}"));
    (row, shown.lines().nth(row).unwrap().chars().collect())
}

/// Frames go on arriving while the screen is paused. The bar ends at the pause all the same, also after a step back.
#[test]
fn the_bar_ends_at_the_pause() {
    let mut stage = begun(Theme::ASCII);
    (1..50).for_each(|n| drop(stage.frame(period(n), 0, change(0, n - 1, n))));
    let pause = period(49);
    stage.draw(pause, 100, 24);
    stage.key(pause, KeyCode::Char(' '));
    let end = |stage: &mut Stage, now| {
        let line: String = bar(stage, now).1.into_iter().collect();
        line.split("] ").nth(1).unwrap().split("  ").next().unwrap().to_owned()
    };
    let first = end(&mut stage, pause);
    (50..90).for_each(|n| drop(stage.frame(period(n), 0, change(0, n - 1, n))));
    stage.key(period(90), KeyCode::Char('['));
    assert_eq!(end(&mut stage, period(90)), first);
}

#[test]
fn the_bar_shows_where_something_went_wrong_and_a_click_leads_there() {
    let mut stage = begun(Theme::ASCII);
    for n in 1..100 {
        stage.frame(period(n), 0, change(0, n - 1, n));
        if n == 30 {
            let gave_up = observed(Event::GaveUp, LIFT, 2, 1);
            stage.frame(period(n), 0, ServerFrame::Events(events(0, &[gave_up])));
        }
    }
    let now = period(99);
    assert!(!text(&stage.draw(now, 100, 24)).contains("{ } trouble"), "nothing is paused");
    stage.key(now, KeyCode::Char(' '));
    let (row, line) = bar(&mut stage, now);
    let place = |line: &[char], sign: char| line.iter().position(|c| *c == sign).unwrap();
    let (start, end) = (place(&line, '['), place(&line, ']'));
    let trouble = place(&line, ':');
    assert!((0.25..0.35).contains(&((trouble - start) as f64 / (end - start) as f64)), "{line:?}");
    assert_eq!(place(&line, '#'), end - 1, "the moment of the pause: {line:?}");
    let click = |stage: &mut Stage, column: usize| {
        let kind = MouseEventKind::Down(MouseButton::Left);
        let at = MouseEvent { kind, column: column as u16, row: row as u16, modifiers: KeyModifiers::NONE };
        stage.app.update(Msg::Mouse(at), now)
    };
    click(&mut stage, trouble);
    let moment = stage.app.moment(now);
    assert!(moment >= period(28) && moment <= period(33), "{moment:?}");
    let (_, line) = bar(&mut stage, now);
    assert_eq!(place(&line, '#'), trouble, "{line:?}");
    click(&mut stage, end - 1);
    assert!(stage.app.gone_back().is_none(), "back at the pause");
    stage.key(now, KeyCode::Char(' '));
    assert!(!text(&stage.draw(now, 100, 24)).contains("{ } trouble"));
    assert!(stage.app.ribbon().is_none());
}

/// The keys that move in a recording move while paused, too, and the help says so.
#[test]
fn the_help_of_a_paused_screen_names_the_keys_that_move() {
    let mut stage = Stage::busy(Theme::ASCII);
    let help = stage.typed(ms(1_200), (120, 200), " ?");
    for key in ["[", "]", "{", "}", "Home", "End"] {
        let line = help.lines().find(|line| line.split_whitespace().next() == Some(key));
        let line = line.unwrap_or_else(|| panic!("{key}: {help}"));
        assert!(line.contains("while paused"), "{key}: {line}");
    }
}
