//! Tests of titles: every column, figure and abbreviation of every screen is explained, by a key, a click and the help.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, ms, text};
use crossterm::event::KeyCode;
use imrs_monitor::app::Screen;
use imrs_monitor::theme::Theme;
use imrs_monitor::view::{explain_column, view};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use std::collections::BTreeSet;
use std::time::Duration;

const NOW: Duration = ms(3_000);
/// The keys to every screen with titles, and some of its titles.
const SCREENS: [(&str, &[&str]); 9] = [
    ("1", &["NODE/TASK/PORT", "STATE", "QUEUE", "SLACK", "HEALTH", "links", "model"]),
    ("2l", &["#", "FROM", "REMAIN", "TIME LEFT", "VERDICT", "buffer", "usage", "since start", "served"]),
    ("2l\n", &["WHERE", "WHAT", "LEFT", "TTL"]),
    ("3", &["MEMBER", "ARRIVED", "CONFIRMS", "WAITS FOR", "GATHERING", "history", "gather"]),
    ("4", &["TIME"]),
    ("5", &["OWNER", "KIND", "LENGTH", "LEFT", "late"]),
    ("6", &["AGO", "!", "NODE", "KIND", "OBJECT", "DETAIL"]),
    ("7", &["seen", "never", "UNKNOWN"]),
    ("8", &["!", "PLACE", "PROBLEM", "CODE"]),
];

/// The cell in trouble, and the cell of twelve nodes.
fn stages() -> [(Stage, Duration); 3] {
    let mut dead = Stage::busy(Theme::ASCII);
    dead.lose(ms(1_500), 2);
    [(Stage::busy(Theme::ASCII), ms(1_150)), (dead, NOW), (Stage::crowd(Theme::ASCII), CROWD_NOW)]
}

fn titles(stage: &Stage, now: Duration, width: u16, height: u16) -> Vec<&'static str> {
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
    view(&stage.app, now, buffer.area, &mut buffer).titles()
}

/// A walk over the titles of all screens at all widths: a new column without an explanation fails here.
#[test]
fn every_title_has_an_explanation_whatever_the_width() {
    for (keys, known) in SCREENS {
        let mut seen = BTreeSet::new();
        for (mut stage, now) in stages() {
            stage.typed(now, (120, 40), keys);
            for width in 40..=200 {
                for title in titles(&stage, now, width, 40) {
                    let told = explain_column(stage.app.screen, title);
                    let told =
                        told.unwrap_or_else(|| panic!("{keys} at {width}: `{title}` is not explained"));
                    assert!(told.len() > title.len() + 6, "{told}");
                    seen.insert(title);
                }
            }
        }
        let missing: Vec<_> = known.iter().filter(|title| !seen.contains(*title)).collect();
        assert!(missing.is_empty(), "{keys}: {missing:?} of {seen:?}");
    }
}

/// Words in capitals, and letters with a number behind them (`p99`), are abbreviations.
fn abbreviations(shown: &str) -> BTreeSet<String> {
    let words = shown.split(|c: char| c.is_whitespace() || ",;:()[]{}<>|=".contains(c));
    let plain = words.map(|word| word.trim_matches(|c: char| !c.is_alphanumeric()));
    let is_short = |word: &&str| {
        let letters = word.trim_end_matches(|c: char| c.is_ascii_digit());
        let is_capital = |c: char| c.is_ascii_uppercase() || c == '/';
        let in_capitals = word.len() > 1 && word.chars().all(is_capital);
        let is_numbered = letters.len() == 1 && letters.len() < word.len() && letters != "v";
        in_capitals || (is_numbered && letters.chars().all(|c| c.is_ascii_lowercase()))
    };
    plain.filter(is_short).map(str::to_owned).collect()
}

/// A walk over the texts of all screens: a new abbreviation without a line in the help fails here.
#[test]
fn every_abbreviation_of_a_screen_stands_in_its_help() {
    let (mut all, mut missing) = (BTreeSet::new(), BTreeSet::new());
    for (keys, _) in SCREENS {
        for (mut stage, now) in stages() {
            let mut found = BTreeSet::new();
            for (width, height) in [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)] {
                let shown = stage.typed(now, (width, height), keys);
                for line in shown.lines() {
                    // A word that ends at the edge may be the beginning of a longer one.
                    let is_cut = line.chars().count() == usize::from(width);
                    let whole =
                        if is_cut { line.rsplit_once(' ').map_or("", |(whole, _)| whole) } else { line };
                    found.extend(abbreviations(whole));
                }
                stage.typed(now, (width, height), "1");
            }
            let help = stage.typed(now, (200, 300), &format!("{keys}?"));
            let columns = help.lines().skip_while(|line| !line.contains("COLUMNS AND FIGURES"));
            let columns = columns.take_while(|line| !line.contains("KEYS ON OTHER SCREENS"));
            let keys_of: String =
                columns.map(|line| line.chars().take(16).collect::<String>() + "\n").collect();
            let known: BTreeSet<String> = keys_of
                .split_whitespace()
                .map(|word| word.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned())
                .collect();
            for word in found {
                let plain = word.trim_end_matches(|c: char| c.is_ascii_digit());
                if !known.contains(plain) {
                    missing.insert(format!("{keys}: {word}"));
                }
                all.insert(word);
            }
        }
    }
    assert!(missing.is_empty(), "not in the help of their screens: {missing:?}");
    assert!(all.len() > 40, "{all:?}");
}

#[test]
fn tab_goes_through_the_titles_and_the_help_begins_with_the_selected_one() {
    for (keys, _) in SCREENS {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.typed(ms(1_150), (120, 40), keys);
        stage.draw(ms(1_150), 120, 40);
        let titles = titles(&stage, ms(1_150), 120, 40);
        for title in titles.iter().chain(titles.first()) {
            stage.key(ms(1_150), KeyCode::Tab);
            assert_eq!(stage.app.title(), Some(*title), "{keys}");
            let buffer = stage.draw(ms(1_150), 120, 40);
            let shown = text(&buffer);
            let told = explain_column(stage.app.screen, title).unwrap();
            assert!(
                shown.lines().last().unwrap().starts_with(&format!(" {told}")),
                "{keys} {title}: {shown}"
            );
            // The title is marked where it stands.
            let marked = (1..39).any(|y| {
                let is_marked = |x: u16| buffer[(x, y)].modifier.contains(ratatui::style::Modifier::REVERSED);
                let marked: String =
                    (0..120).filter(|&x| is_marked(x)).map(|x| buffer[(x, y)].symbol()).collect();
                marked.contains(title)
            });
            assert!(marked, "{keys} {title}");
        }
        stage.key(ms(1_150), KeyCode::BackTab);
        let (screen, title) = (stage.app.screen, *titles.last().unwrap());
        assert_eq!(stage.app.title(), Some(title), "{keys}");
        let help = stage.typed(ms(1_150), (120, 40), "?");
        assert_eq!(stage.app.screen, Screen::Help);
        let row = help
            .lines()
            .find(|line| line.trim_start_matches(['>', ' ']).starts_with(title))
            .unwrap_or_default();
        let told = explain_column(screen, title).unwrap();
        assert!(row.contains(told.split_once(": ").unwrap().1.get(..20).unwrap()), "{keys} {title}: {help}");
        // Back on the screen the title is still selected. Another key ends that, and Esc only that.
        stage.key(ms(1_150), KeyCode::Esc);
        assert_eq!((stage.app.screen, stage.app.title()), (screen, Some(title)), "{keys}");
        stage.key(ms(1_150), KeyCode::Esc);
        assert_eq!((stage.app.screen, stage.app.title()), (screen, None), "{keys}");
        stage.draw(ms(1_150), 120, 40);
        stage.key(ms(1_150), KeyCode::Tab);
        stage.keys(ms(1_150), "j");
        assert_eq!(stage.app.title(), None, "{keys}");
    }
}

/// At forty columns an explanation is longer than the bottom line; the help has it whole.
#[test]
fn the_help_wraps_what_has_no_room() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.typed(ms(1_150), (40, 12), "");
    while stage.app.title() != Some("SLACK") {
        stage.key(ms(1_150), KeyCode::Tab);
    }
    let help = stage.typed(ms(1_150), (40, 12), "?");
    // The last column is the scrollbar.
    let words: Vec<&str> =
        help.lines().flat_map(|line| line.get(..39).unwrap_or(line).split_whitespace()).collect();
    let told = explain_column(Screen::Overview, "SLACK").unwrap();
    let told: Vec<&str> = told.split_once(": ").unwrap().1.split(' ').collect();
    assert!(words.windows(told.len()).any(|window| window == told), "{help}");
    for width in [40, 64, 80] {
        let shown = stage.text(ms(1_150), width, 250);
        for (_, titles) in &SCREENS[..1] {
            for title in *titles {
                let told = explain_column(Screen::Overview, title).unwrap_or_default();
                let last = told.split(' ').next_back().unwrap_or_default();
                assert!(shown.contains(last), "{title} at {width}: {shown}");
            }
        }
    }
}

#[test]
fn a_screen_without_titles_says_so() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.typed(ms(1_150), (120, 40), "?");
    stage.key(ms(1_150), KeyCode::Tab);
    assert!(stage.text(ms(1_150), 120, 40).contains("no column and no figure of this screen has a title"));
}
