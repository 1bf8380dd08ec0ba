//! Tests of every screen at every size in every style: they compare each cell of the screen, with text and style.

use crate::common::{BEAT, HALT, LIFT, Stage, at, events, left, ms, observed, snapshot, styles, text};
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_monitor::app::{Effect, Msg, Screen};
use imrs_monitor::keymap::Keymap;
use imrs_monitor::keys::{Action, BINDINGS};
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, MeetingState, Reason, TaskId, TaskState, Ticks};
use imrs_wire::obs::{HeldBack, HeldTask, ServerFrame};
use std::time::Duration;

const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];
const STYLES: [Theme; 3] = [Theme::COLOUR, Theme::MONO, Theme::ASCII];
const NOW: Duration = ms(1_150);
const LATER: Duration = ms(1_700);

/// Both arms wait for the hoist; some messages are dropped.
fn stage(theme: Theme) -> Stage {
    let mut stage = Stage::cell(theme);
    let happened = [
        observed(Event::Discarded(Reason::Expired), BEAT, 0, 8_810),
        observed(Event::Discarded(Reason::Expired), BEAT, 0, 8_811),
        observed(Event::Discarded(Reason::Duplicate), HALT, 2, 3),
        observed(Event::PartnerAborted, LIFT, 2, 11),
        observed(Event::GaveUp, LIFT, 2, 11),
        observed(Event::Sent, BEAT, 0, 8_812),
    ];
    stage.frame(ms(1_050), 1, ServerFrame::Events(events(1, &happened)));
    stage
}

fn dead(theme: Theme) -> Stage {
    let mut stage = stage(theme);
    stage.lose(ms(1_100), 2);
    stage
}

/// The user sets a mark, and then two more messages expire.
fn marked(theme: Theme) -> Stage {
    let mut stage = stage(theme);
    stage.keys(ms(1_060), "m");
    let mut later = snapshot(1);
    let beat = later.tasks[0].view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    beat.counters.expired += 2;
    stage.frame(ms(1_100), 1, ServerFrame::Snapshot(later));
    stage
}

/// The hoist's node was restarted, and its script is held back.
fn held_back(theme: Theme) -> Stage {
    let mut stage = dead(theme);
    stage.attach(ms(1_110), 2, 2);
    let tasks = vec![HeldTask { task: TaskId(2), remaining: Ticks(61_400_000) }];
    stage.frame(ms(1_110), 2, ServerFrame::HeldBack(HeldBack { mono_us: 5_000_000, tasks }));
    stage
}

/// A scene: its name, its stage, and the keys that open its screen.
type Scene = (&'static str, fn(Theme) -> Stage, &'static str);

/// The right arm has answered many messages of `beat` in four milliseconds each, and its buffer is full.
fn served(theme: Theme) -> Stage {
    let mut stage = Stage::busy(theme);
    let beats = (0..8).flat_map(|n| {
        let at = 4_900 + 4 * u64::from(n);
        let number = 8_900 + n;
        [
            (at, left(Event::Enqueued, BEAT, 0, number, 190)),
            (at, left(Event::Delivered, BEAT, 0, number, 190)),
            (at + 4, left(Event::Replied, BEAT, 0, number, 186)),
        ]
    });
    let beats: Vec<_> = beats.collect();
    stage.frame(ms(1_100), 1, ServerFrame::Events(at(1, &beats)));
    let rejected: Vec<_> = (0..3).map(|n| (4_940 + n, left(Event::Rejected, BEAT, 0, 8_813, 140))).collect();
    stage.frame(ms(1_100), 1, ServerFrame::Events(at(1, &rejected)));
    let mut full = snapshot(1);
    let beat = full.tasks[0].view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    for entry in &mut beat.queue {
        entry.remaining = imrs_protocol::Ticks(entry.remaining.0 + 50_000);
    }
    beat.queue[0].remaining = imrs_protocol::Ticks(52_000);
    beat.queue[2].class = imrs_protocol::Class::Status;
    beat.len = 8;
    stage.frame(ms(1_100), 1, ServerFrame::Snapshot(full));
    stage
}

/// The left arm waits for the right arm at the lift, and the right arm waits for a message of `beat` from the left arm.
pub fn cycle(theme: Theme) -> Stage {
    let mut stage = Stage::cell(theme);
    let mut left = snapshot(0);
    left.tasks[0].view.meetings[0].members[1].arrived = false;
    stage.frame(ms(1_100), 0, ServerFrame::Snapshot(left));
    let mut right = snapshot(1);
    let view = &mut right.tasks[0].view;
    view.state = TaskState::Receiving { port: Some(BEAT), remaining: None };
    view.meetings[0].state = MeetingState::Away;
    view.meetings[0].remaining = None;
    let beat = view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
    (beat.len, beat.min_slack) = (0, None);
    beat.queue.clear();
    stage.frame(ms(1_100), 1, ServerFrame::Snapshot(right));
    stage
}

const SCENES: [Scene; 28] = [
    ("overview", stage, ""),
    ("overview_dead", dead, "jjjj"),
    ("overview_filter", stage, "/bea"),
    ("overview_sorted", dead, "sss"),
    ("port", stage, "2l"),
    ("rendezvous", stage, "3"),
    ("rendezvous_dead", dead, "3"),
    ("events", dead, "6"),
    ("events_held", dead, "6akk"),
    ("help", stage, "?"),
    ("help_port", stage, "2?"),
    ("help_timeline", stage, "4?"),
    ("port_served", served, "2lj"),
    ("message", served, "2l\n"),
    ("rendezvous_cycle", cycle, "3"),
    ("rendezvous_busy", Stage::busy, "3"),
    ("timeline", Stage::busy, "4"),
    ("timeline_held", Stage::busy, "4lkkkk"),
    ("timeline_zoomed", Stage::busy, "4----"),
    ("timers", Stage::busy, "5"),
    ("model", Stage::busy, "7"),
    ("overview_marked", marked, "d"),
    ("problems", Stage::busy, "8"),
    ("problems_dead", dead, "8j"),
    ("explain", dead, "8x"),
    ("settings", Stage::busy, "5oj"),
    ("command", stage, ":port be"),
    ("overview_held_back", held_back, ""),
];

fn snap(name: &str, make: impl Fn(Theme) -> Stage, keys: &str, now: Duration) {
    for (width, height) in SIZES {
        let mut shown = String::new();
        for theme in STYLES {
            let mut stage = make(theme);
            stage.typed(now, (width, height), keys);
            let buffer = stage.buffer(now, width, height);
            shown += &format!("=== {}\n{}--- styles\n{}", theme.name, text(&buffer), styles(&buffer));
            if theme == Theme::ASCII {
                assert!(text(&buffer).is_ascii(), "{name}");
            }
            if theme != Theme::COLOUR {
                assert!(buffer.content.iter().all(|c| c.fg == ratatui::style::Color::Reset), "{name}");
            }
        }
        insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
            insta::assert_snapshot!(format!("{name}_{width}x{height}"), shown);
        });
    }
}

#[test]
fn screens_look_as_recorded() {
    for (name, make, keys) in SCENES {
        // The banner names a dead task only half a second after its death.
        let now = if name.ends_with("_dead") { LATER } else { NOW };
        snap(name, make, keys, now);
    }
    snap("waiting", Stage::new, "", NOW);
    let paused = |theme| {
        let mut stage = stage(theme);
        stage.key(ms(1_060), KeyCode::Char(' '));
        stage
    };
    snap("paused", paused, "", ms(60_000));
    println!("{} frames", (SCENES.len() + 2) * SIZES.len() * STYLES.len());
}

#[test]
fn countdowns_count_down() {
    let mut stage = stage(Theme::ASCII);
    stage.keys(NOW, "2l");
    let remain = |now| {
        let text = stage.text(now, 80, 24);
        let row = text.lines().find(|l| l.contains("#1.8815")).unwrap().to_owned();
        (row.split_whitespace().find(|w| w.ends_with("ms")).unwrap().to_owned(), row.matches('#').count())
    };
    assert_eq!(remain(ms(1_000)).0, "180ms");
    assert_eq!(remain(ms(1_050)).0, "130ms");
    assert!(remain(ms(1_000)).1 > remain(ms(1_150)).1, "the bar shrinks");
}

#[test]
fn no_size_panics_and_nothing_is_drawn_outside() {
    for theme in Theme::ALL {
        for (_, make, keys) in SCENES {
            let mut stage = make(theme);
            stage.keys(NOW, keys);
            for width in [0, 1, 2, 3, 5, 8, 13, 39, 59, 60, 61, 99, 100, 160] {
                for height in [0, 1, 2, 3, 4, 7] {
                    stage.typed(NOW, (width, height), "jk");
                }
            }
        }
    }
}

#[test]
fn the_selection_is_marked_by_a_sign_and_by_reversing_in_every_theme() {
    for theme in Theme::ALL {
        let mut stage = dead(theme);
        stage.keys(NOW, "jj");
        let buffer = stage.buffer(NOW, 80, 24);
        let marked = (0..24).find(|&y| buffer[(0, y)].symbol() == ">").expect("a sign");
        assert_eq!(marked, 5);
        let reversed =
            (0..80).all(|x| buffer[(x, marked)].modifier.contains(ratatui::style::Modifier::REVERSED));
        assert!(reversed, "{}", theme.name);
    }
}

#[test]
fn the_help_lists_every_key_and_every_key_does_something_where_it_says() {
    let mut stage = stage(Theme::ASCII);
    stage.keys(NOW, "?");
    let text = stage.text(NOW, 120, 250);
    let keymap = Keymap::default();
    for binding in BINDINGS {
        let told = |line: &str| line.contains(binding.help) && line.contains(&keymap.label(binding));
        assert!(text.lines().any(told), "{} {}", keymap.label(binding), binding.help);
        for screen in Screen::ALL.into_iter().filter(|s| binding.is_on(*s)) {
            for key in binding.keys {
                let modifiers = if key.ctrl { KeyModifiers::CONTROL } else { KeyModifiers::NONE };
                let event = KeyEvent::new(key.code, modifiers);
                assert_eq!(keymap.action(&event, screen), Some(binding.action), "{key:?} on {screen:?}");
                press(&event, screen, binding.action);
            }
        }
    }
}

/// Checks that a key has an effect on its screens. Keys that move in recordings need a recording.
fn press(event: &KeyEvent, screen: Screen, action: Action) {
    let mut stage = Stage::busy(Theme::ASCII);
    if screen == Screen::Message {
        stage.keys(NOW, "2l\n");
    } else if screen == Screen::Settings {
        stage.keys(NOW, "o");
    } else if screen == Screen::Explain {
        stage.keys(NOW, "8x");
    } else if let Some(show) = BINDINGS.iter().find(|b| b.action == Action::Show(screen)) {
        stage.key(NOW, show.keys[0].code);
    }
    assert_eq!(stage.app.screen, screen);
    let effect = stage.app.update(Msg::Key(*event), NOW);
    let of_recordings = matches!(
        action,
        Action::StepBack
            | Action::StepOn
            | Action::PreviousAnomaly
            | Action::NextAnomaly
            | Action::MoreOfStep
    );
    assert_eq!(effect == Effect::Nothing, of_recordings, "{event:?} on {screen:?}");
}

#[test]
fn a_trouble_is_shown_at_the_foot() {
    let mut stage = stage(Theme::ASCII);
    stage.feed(NOW, 9, Feed::Failed { why: "unix:/x.sock: it speaks imrs-obs 2.0, this monitor 1.0".into() });
    assert!(stage.text(NOW, 120, 24).contains("! unix:/x.sock: it speaks imrs-obs 2.0"));
}
