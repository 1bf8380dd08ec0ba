//! Every screen of a cell with twelve nodes and 108 ports, at five sizes, as recorded text.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, text};
use imrs_monitor::theme::Theme;
use std::fmt::Write as _;

const SIZES: [(u16, u16); 5] = [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)];
/// The screens, and the keys that open them.
const SCREENS: [(&str, &str); 13] = [
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
];

#[test]
fn screens_of_a_large_cell_look_as_recorded() {
    for (width, height) in SIZES {
        let mut shown = String::new();
        for (name, keys) in SCREENS {
            let mut stage = Stage::crowd(Theme::MONO);
            stage.typed(CROWD_NOW, (width, height), keys);
            let _ = write!(shown, "=== {name}\n{}", text(&stage.draw(CROWD_NOW, width, height)));
        }
        insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
            insta::assert_snapshot!(format!("crowd_{width}x{height}"), shown);
        });
    }
}
