//! Every screen at every size in every style, to the cell: text and styles.

mod common;

use common::{BEAT, HALT, LIFT, Stage, events, ms, observed, styles, text};
use crossterm::event::KeyCode;
use imrs_monitor::app::{Msg, Screen};
use imrs_monitor::keys::BINDINGS;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Reason};
use imrs_wire::obs::ServerFrame;
use std::time::Duration;

const SIZES: [(u16, u16); 4] = [(40, 12), (80, 24), (120, 40), (200, 60)];
const NOW: Duration = ms(1_150);

/// The hoist dies with both arms waiting for it; some messages are dropped.
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

/// A scene's name, and how to get there.
type Scene = (&'static str, fn(Theme) -> Stage, &'static str);

const SCENES: [Scene; 10] = [
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
];

fn snap(name: &str, make: impl Fn(Theme) -> Stage, keys: &str, now: Duration) {
    for (width, height) in SIZES {
        let mut shown = String::new();
        for theme in [Theme::COLOUR, Theme::MONO, Theme::ASCII] {
            let mut stage = make(theme);
            stage.app.update(Msg::Resize(width, height), now);
            stage.keys(now, keys);
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
        snap(name, make, keys, NOW);
    }
    snap("waiting", Stage::new, "", NOW);
    let paused = |theme| {
        let mut stage = stage(theme);
        stage.key(ms(1_060), KeyCode::Char(' '));
        stage
    };
    snap("paused", paused, "", ms(60_000));
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
                    stage.app.update(Msg::Resize(width, height), NOW);
                    let _ = stage.buffer(NOW, width, height);
                    stage.keys(NOW, "jk");
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
        assert_eq!(marked, 4);
        let reversed =
            (0..80).all(|x| buffer[(x, marked)].modifier.contains(ratatui::style::Modifier::REVERSED));
        assert!(reversed, "{}", theme.name);
    }
}

#[test]
fn the_help_lists_every_key_and_every_key_does_something_where_it_says() {
    let mut stage = stage(Theme::ASCII);
    stage.keys(NOW, "?");
    let text = stage.text(NOW, 120, 100);
    for binding in BINDINGS {
        let line =
            text.lines().find(|l| l.contains(binding.help)).unwrap_or_else(|| panic!("{}", binding.help));
        assert!(line.contains(&binding.label()), "{line}");
        let screens = [Screen::Overview, Screen::Port, Screen::Rendezvous, Screen::Events, Screen::Help];
        for screen in screens.into_iter().filter(|s| binding.is_on(*s)) {
            for key in binding.keys {
                let modifiers = if key.ctrl {
                    crossterm::event::KeyModifiers::CONTROL
                } else {
                    crossterm::event::KeyModifiers::NONE
                };
                let event = crossterm::event::KeyEvent::new(key.code, modifiers);
                assert_eq!(
                    imrs_monitor::keys::action(&event, screen),
                    Some(binding.action),
                    "{key:?} on {screen:?}"
                );
            }
        }
    }
}

#[test]
fn a_trouble_is_shown_at_the_foot() {
    let mut stage = stage(Theme::ASCII);
    stage.feed(NOW, 9, Feed::Failed { why: "unix:/x.sock: it speaks imrs-obs 2.0, this monitor 1.0".into() });
    assert!(stage.text(NOW, 120, 24).contains("! unix:/x.sock: it speaks imrs-obs 2.0"));
}
