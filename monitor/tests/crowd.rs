//! Every screen of a cell with twelve nodes and 108 ports, at five sizes, as recorded text.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, ms, styles, text};
use imrs_monitor::app::Screen;
use imrs_monitor::theme::Theme;
use std::fmt::Write as _;
use std::time::Duration;

/// A moment before anything goes wrong in the large cell.
const CROWD_WELL: Duration = ms(5_050);

const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];
/// The scenes: a name, the keys that lead there, and the screen that must then be shown.
const SCENES: [(&str, &str, Screen); 18] = [
    ("overview", "", Screen::Overview),
    ("overview, opened", "Gl", Screen::Overview),
    ("overview, no match", "/zzz\n", Screen::Overview),
    ("port", "2", Screen::Port),
    ("message", "6k\n", Screen::Message),
    ("rendezvous", "3", Screen::Rendezvous),
    ("timeline", "4", Screen::Timeline),
    ("timers", "5", Screen::Timers),
    ("events", "6", Screen::Events),
    ("model", "7", Screen::Model),
    ("problems", "8", Screen::Problems),
    ("explanation", "8x", Screen::Explain),
    ("help", "?", Screen::Help),
    ("filter", "/queue>2", Screen::Overview),
    ("settings", "oj", Screen::Settings),
    ("paused", " ", Screen::Overview),
    ("paused, a second back", " [[[[[[[[[[", Screen::Overview),
    ("typed line", ":port port4", Screen::Overview),
];

/// A scene of the large cell, once its keys have led to its screen.
fn scene((name, keys, screen): (&str, &str, Screen), theme: Theme, size: (u16, u16)) -> Stage {
    let mut stage = Stage::crowd_at_work(theme);
    stage.typed(CROWD_NOW, size, keys);
    assert_eq!(stage.app.screen, screen, "{name}");
    stage
}

#[test]
fn screens_of_a_large_cell_look_as_recorded() {
    for (width, height) in SIZES {
        let mut shown = String::new();
        for one in SCENES {
            let mut stage = scene(one, Theme::MONO, (width, height));
            let _ = write!(shown, "=== {}\n{}", one.0, text(&stage.draw(CROWD_NOW, width, height)));
        }
        let well = text(&Stage::crowd_for(Theme::MONO, 40).draw(CROWD_WELL, width, height));
        let _ = write!(shown, "=== all healthy\n{well}");
        insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
            insta::assert_snapshot!(format!("crowd_{width}x{height}"), shown);
        });
    }
}

#[test]
fn screens_of_a_large_cell_have_their_colours() {
    let mut shown = String::new();
    for one in SCENES {
        let mut stage = scene(one, Theme::COLOUR, (120, 40));
        let _ = write!(shown, "=== {}\n{}", one.0, styles(&stage.draw(CROWD_NOW, 120, 40)));
    }
    insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
        insta::assert_snapshot!("crowd_styles_120x40", shown);
    });
}

/// The screens of the large cell show what they are there for.
#[test]
fn every_screen_of_a_large_cell_has_something_to_show() {
    for (keys, parts) in [
        ("", &["BLOCKED BY task9@node3", "holds 3 of 36", "2 nodes UNKNOWN"][..]),
        ("2", &["node0", "#1.700"]),
        ("3", &["gather", "GATHERING 3/4", "MISSING, DEAD"]),
        ("4", &["answer port"]),
        ("5", &["timer", "delay", "waitfor"]),
        ("6", &["dead", "x12", "port45 at task15"]),
        ("7", &["node1  conforms  4007 steps checked"]),
        ("8", &["task9@node3", "node5", "MISS"]),
        ("o", &["theme"]),
        (" [", &["PAUSED -"]),
        (":port port4", &["port40"]),
    ] {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (120, 40), keys);
        for part in parts {
            assert!(shown.contains(part), "{keys}: {part}: {shown}");
        }
    }
}

/// Narrow lists of events have no column for the node. There an event about a node itself still names the node.
#[test]
fn the_narrow_list_of_events_says_which_node_died() {
    for width in 40..=80 {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, 12), "6");
        let mut events = shown.lines().skip(3).take(8);
        let dead = events.find(|line| line.contains(" dead ")).unwrap_or_else(|| panic!("{width}: {shown}"));
        assert!(dead.contains(" node3 "), "{width}: {shown}");
    }
}

/// If no node is in trouble, the only row of the overview says which nodes are up, in whole names.
#[test]
fn a_healthy_large_cell_says_so_in_words() {
    for width in 60..=200 {
        let shown = Stage::crowd_for(Theme::ASCII, 40).typed(CROWD_WELL, (width, 20), "");
        let row = shown.lines().find(|line| line.contains("+ 12 nodes")).expect("the healthy nodes");
        assert!(row.contains(" up: node0") && row.ends_with(" ok"), "{width}: {row}");
        let state = row.split(" up: ").nth(1).unwrap().split_whitespace();
        let mut names = state.take_while(|word| !word.contains('/')).map(|word| word.trim_end_matches(','));
        let is_whole = |name: &str| {
            name.strip_prefix("node").or(name.strip_prefix('+')).is_some_and(|n| n.parse::<u16>().is_ok())
        };
        assert!(names.all(is_whole), "{width}: {row}");
    }
}

#[test]
fn a_filter_without_a_match_says_so() {
    for (width, height) in SIZES {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, height), "/zzz\n");
        assert!(shown.contains(" No row fulfils this filter"), "{width}: {shown}");
    }
}
