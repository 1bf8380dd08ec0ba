//! Tests of small texts: they can be read to their end, say what is meant, and offer only what helps.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, ms, snapshot};
use imrs_monitor::app::{Screen, Setting};
use imrs_monitor::problems::Problem;
use imrs_monitor::theme::Theme;
use imrs_wire::obs::ServerFrame;
use std::time::Duration;

const NOW: Duration = ms(1_100);

#[test]
fn each_setting_is_read_to_its_end() {
    let wide = Stage::busy(Theme::ASCII).typed(NOW, (80, 24), "o");
    // A low window scrolls.
    let narrow = ["o", "ojjjjjjjj"].map(|keys| Stage::busy(Theme::ASCII).typed(NOW, (40, 12), keys)).concat();
    for setting in Setting::ALL {
        let (long, short, key) = setting.about();
        let key = if key.is_empty() { String::new() } else { format!("  ({key})") };
        assert!(wide.contains(&format!("{long}{key} ")), "{long}{key}: {wide}");
        assert!(narrow.contains(&format!(" {short} ")), "{short}: {narrow}");
    }
}

#[test]
fn a_screen_without_a_filter_says_so() {
    for (keys, screen) in [
        ("8", Screen::Problems),
        ("2", Screen::Port),
        ("5", Screen::Timers),
        ("3", Screen::Rendezvous),
        ("7", Screen::Model),
    ] {
        let mut stage = Stage::busy(Theme::ASCII);
        let shown = stage.typed(NOW, (80, 24), &format!("{keys}/"));
        assert_eq!(stage.app.screen, screen);
        assert!(shown.contains("no filter on this screen; there is one on 1, 4 and 6"), "{keys}: {shown}");
    }
}

#[test]
fn no_name_is_offered_in_place_of_a_number_and_none_is_cut() {
    let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (80, 24), "/queue>2");
    assert!(!shown.contains("Tab:"), "{shown}");
    for width in 60..=130 {
        let mut stage = Stage::crowd_at_work(Theme::ASCII);
        let shown = stage.typed(CROWD_NOW, (width, 24), ":port port4");
        let words = shown.lines().last().unwrap().split("Tab: ").nth(1).unwrap().split_whitespace();
        let known = stage.app.completion().words;
        for word in words {
            assert!(known.iter().any(|one| one == word), "{width}: {word}: {shown}");
        }
    }
}

/// Likely misses come first, and among them the message with the least remaining time, however much time others need.
#[test]
fn the_nearest_deadline_comes_first_among_likely_misses() {
    let stage = Stage::crowd_at_work(Theme::ASCII);
    let app = &stage.app;
    let rows = app.problems(&app.findings(CROWD_NOW), &app.blockers(CROWD_NOW), CROWD_NOW);
    let near = rows.iter().filter_map(|row| if let Problem::Message(near) = row { Some(near) } else { None });
    let near: Vec<_> = near.map(|near| (!near.is_miss(), near.left.us)).collect();
    let misses: Vec<_> = near.iter().filter(|(is_well, _)| !is_well).collect();
    assert!(misses.len() > 1 && near.is_sorted_by_key(|(is_well, _)| *is_well), "{near:?}");
    assert!(misses.is_sorted(), "{near:?}");
}

/// The number of a delay is the runtime's own.
#[test]
fn a_delay_has_no_number() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.frame(NOW, 0, ServerFrame::Snapshot(snapshot(0)));
    let shown = stage.typed(NOW, (120, 24), "5");
    let delay = shown.lines().find(|line| line.contains(" delay ")).unwrap();
    assert!(!delay.contains("t255"), "{delay}");
}

/// At forty columns the header of a paused screen is read to its end.
#[test]
fn the_header_of_a_pause_is_whole() {
    for (keys, tab) in
        [("", "[1 Over]"), ("4", "[4 Time]"), ("5", "[5"), ("6", "[6"), ("8", "[8 Prob]"), ("o", "[1 Over]")]
    {
        for back in [" ", " [", " [[[[[[[[[[[["] {
            let shown =
                Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (40, 12), &format!("{keys}{back}"));
            let head = shown.lines().next().unwrap();
            assert!(head.contains(tab) && head.ends_with(']'), "{keys}{back}: {head}");
            assert!(head.contains(" specimen ") && head.contains(" PAUSED"), "{keys}{back}: {head}");
        }
    }
}
