//! Every screen of a cell with twelve nodes and 108 ports, at five sizes, as recorded text.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, styles, text};
use imrs_monitor::theme::Theme;
use std::fmt::Write as _;

const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];
/// The screens, and the keys that open them.
const SCREENS: [(&str, &str); 17] = [
    ("overview", ""),
    ("overview, opened", "Gl"),
    ("port", "2"),
    ("message", "6\n"),
    ("rendezvous", "3"),
    ("timeline", "4"),
    ("timers", "5"),
    ("events", "6"),
    ("model", "7"),
    ("problems", "8"),
    ("explanation", "8x"),
    ("help", "?"),
    ("filter", "/queue>2"),
    ("settings", "oj"),
    ("paused", " "),
    ("paused, a second back", " [[[[[[[[[["),
    ("typed line", ":port port4"),
];

#[test]
fn screens_of_a_large_cell_look_as_recorded() {
    for (width, height) in SIZES {
        let mut shown = String::new();
        for (name, keys) in SCREENS {
            let mut stage = Stage::crowd_at_work(Theme::MONO);
            stage.typed(CROWD_NOW, (width, height), keys);
            let _ = write!(shown, "=== {name}\n{}", text(&stage.draw(CROWD_NOW, width, height)));
        }
        insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
            insta::assert_snapshot!(format!("crowd_{width}x{height}"), shown);
        });
    }
}

#[test]
fn screens_of_a_large_cell_have_their_colours() {
    let mut shown = String::new();
    for (name, keys) in SCREENS {
        let mut stage = Stage::crowd_at_work(Theme::COLOUR);
        stage.typed(CROWD_NOW, (120, 40), keys);
        let _ = write!(shown, "=== {name}\n{}", styles(&stage.draw(CROWD_NOW, 120, 40)));
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
