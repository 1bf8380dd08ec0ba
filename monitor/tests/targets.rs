//! Test of the targets of clicks: a walk over all drawn texts.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, ms};
use crossterm::event::KeyCode;
use imrs_monitor::app::Screen;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_monitor::view::view;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use std::collections::BTreeSet;
use std::time::Duration;

const NOW: Duration = ms(1_150);
const LATER: Duration = ms(3_000);
const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];

/// Texts that only inform, by their beginnings: a click on them has nothing to do. Everything else is a target.
const INFORM: &[&str] = &[
    // A screen or a table without a row.
    "- no message waits -",
    "This cell has no waitfor.",
    "Nothing has happened since the monitor",
    "Its history is gone",
    // The history of a message as a sentence.
    "sent with",
    "enqueued with",
    "duplicate with",
    // What happened in a step of a counterexample, and the statement in the cell's file.
    "0 ticks later",
    "SEND #4 of armL leaves for nr",
    "beam.cell:31:5",
    "waitfor lift();",
];

/// The keys to every screen, with the window of the settings, and with a line that is being typed.
const KEYS: [(Screen, &str); 16] = [
    (Screen::Overview, "1"),
    (Screen::Overview, "s"),
    (Screen::Overview, "/halt"),
    (Screen::Overview, ":port b"),
    (Screen::Overview, "/slack<"),
    (Screen::Port, "2l"),
    (Screen::Message, "2l\n"),
    (Screen::Rendezvous, "3"),
    (Screen::Timeline, "4"),
    (Screen::Timers, "5"),
    (Screen::Events, "6xkk"),
    (Screen::Model, "7"),
    (Screen::Problems, "8"),
    (Screen::Explain, "8x"),
    (Screen::Settings, "2o"),
    (Screen::Help, "?"),
];

fn dead() -> Stage {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_500), 2);
    stage
}

pub fn paused() -> Stage {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.key(NOW, KeyCode::Char(' '));
    stage
}

pub fn troubled() -> Stage {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.feed(NOW, 9, Feed::Failed { why: "unix:/x.sock: it speaks imrs-obs 2.0, this monitor 1.0".into() });
    stage.app.recording = Some("run.imrs".into());
    stage
}

/// The runs of text without a target: parts of a row that two spaces or a target separate.
fn texts_without_target(stage: &Stage, now: Duration, (width, height): (u16, u16)) -> Vec<String> {
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
    let drawn = view(&stage.app, now, buffer.area, &mut buffer);
    let mut found = Vec::new();
    for y in 0..height {
        let free = |x: u16| if drawn.hit(x, y).is_some() { "  " } else { buffer[(x, y)].symbol() };
        let row: String = (0..width).map(free).collect();
        found.extend(row.split("  ").map(|run| run.trim().to_owned()));
    }
    found.retain(|run| run.contains(char::is_alphanumeric));
    found
}

#[test]
fn every_text_of_every_screen_is_a_target_or_only_informs() {
    let walked: BTreeSet<_> = KEYS.iter().map(|(screen, _)| format!("{screen:?}")).collect();
    assert_eq!(walked, Screen::ALL.iter().map(|screen| format!("{screen:?}")).collect());
    let stages = [
        (Stage::busy(Theme::ASCII), NOW),
        (dead(), LATER),
        (paused(), NOW),
        (troubled(), NOW),
        (crate::replay::stage(Theme::ASCII), NOW),
        (Stage::crowd(Theme::ASCII), CROWD_NOW),
    ];
    let (mut missing, mut used) = (BTreeSet::new(), BTreeSet::new());
    for (screen, keys) in KEYS {
        for size in SIZES {
            for (stage, now) in &stages {
                let mut stage = Stage { app: stage.app.clone() };
                stage.typed(*now, size, keys);
                // No message waits at the first ports of the large cell.
                let is_there = stage.app.screen == screen;
                assert!(is_there || (screen == Screen::Message && *now == CROWD_NOW), "{keys}");
                for run in texts_without_target(&stage, *now, size) {
                    match INFORM.iter().find(|text| run.starts_with(*text)) {
                        Some(text) => drop(used.insert(*text)),
                        None => drop(missing.insert(format!("{keys} {}: {run}", size.0))),
                    }
                }
            }
        }
    }
    let missing: Vec<_> = missing.iter().map(String::as_str).collect();
    assert!(missing.is_empty(), "no target:\n{}", missing.join("\n"));
    assert_eq!(used.len(), INFORM.len(), "only {used:?} of the list are drawn");
}
