//! Tests how much memory moving back in the history takes while the screen is paused (goal M7). The test runs in a
//! process of its own.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_monitor::app::{App, Msg};
use imrs_monitor::clock::Moment;
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_wire::obs::{Delta, ServerFrame};
use std::time::{Duration, Instant};

/// A cell of twelve nodes with four tasks of three ports each.
const CELL: Specimen = Specimen { nodes: 12, tasks: 4, ports: 3, queue_limit: 6 };
/// The number of steps back whose time is measured.
const NEAR: usize = 50;
/// The greatest memory of the whole process, in bytes.
const GOAL: usize = 64 << 20;
/// The memory that moving back may take in addition, in bytes.
const BACK: usize = 24 << 20;
/// The memory that may stay after moving back ends, in bytes: moving back takes 14 MB.
const STAYS: usize = 3 << 20;

/// The resident anonymous memory of this process, in bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<usize>().unwrap() * 1024
}

fn press(app: &mut App, key: KeyCode, now: Moment) {
    app.update(Msg::Key(KeyEvent::new(key, KeyModifiers::NONE)), now);
}

#[test]
fn moving_back_over_minutes_of_twelve_nodes_fits_the_budget() {
    let mut app = App::new(Theme::MONO, None);
    let start = Duration::from_secs(1);
    for arrival in CELL.arrivals(start) {
        app.update(Msg::Feed(arrival), start);
    }
    let mut states: Vec<_> = (0..CELL.nodes).map(|node| CELL.snapshot(node)).collect();
    let mut now = start;
    for period in 1..=1_200 {
        now = start + Duration::from_millis(100 * period);
        for (node, state) in (0..CELL.nodes).zip(&mut states) {
            let before = state.clone();
            Specimen::go_on(state, period, 20);
            for frame in
                [ServerFrame::Delta(Delta::between(&before, state)), ServerFrame::Events(CELL.events(node))]
            {
                app.update(Msg::Feed(Specimen::said(node, now, frame)), now);
            }
        }
    }
    let live = resident();
    press(&mut app, KeyCode::Char(' '), now);
    press(&mut app, KeyCode::Home, now);
    for _ in 0..40 {
        (0..30).for_each(|_| press(&mut app, KeyCode::Char(']'), now));
        press(&mut app, KeyCode::Char('['), now);
    }
    press(&mut app, KeyCode::End, now);
    let start = Instant::now();
    press(&mut app, KeyCode::Char('['), now);
    println!("{:?} for the first step back", start.elapsed());
    let start = Instant::now();
    (0..NEAR).for_each(|_| press(&mut app, KeyCode::Char('['), now));
    println!("{:?} for {NEAR} steps back from the pause", start.elapsed());
    press(&mut app, KeyCode::Home, now);
    let back = resident();
    press(&mut app, KeyCode::End, now);
    press(&mut app, KeyCode::Char(' '), now);
    let after = resident();
    println!("twelve nodes: {live} bytes live, {back} while moving back, {after} after it");
    assert!(back <= GOAL, "{back} of {GOAL} bytes while moving back");
    assert!(back.saturating_sub(live) <= BACK, "{live} bytes live, {back} while moving back");
    assert!(back.saturating_sub(live) > 2 * STAYS, "{live} bytes live, only {back} while moving back");
    assert!(after.saturating_sub(live) <= STAYS, "{live} bytes live, {after} after moving back");
}
