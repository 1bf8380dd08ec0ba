//! Tests of titles: every column, figure and abbreviation of every screen is explained, by a key, a click and the help.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, ms, text};
use crossterm::event::KeyCode;
use imrs_monitor::app::Screen;
use imrs_monitor::theme::Theme;
use imrs_monitor::view::{explain_column, view};
use imrs_wire::obs::{Pong, ServerFrame};
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

/// Visits the titles of all screens at all widths. A new column without an explanation makes this test fail.
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

/// The help of the screen that these keys open: what it says about columns, figures, the header and the banner.
fn explained(stage: &mut Stage, now: Duration, keys: &str, width: u16) -> Vec<String> {
    let help = stage.typed(now, (width, 400), &format!("{keys}?"));
    let lines = help.lines().skip_while(|line| !line.contains("COLUMNS AND FIGURES"));
    let lines: Vec<_> =
        lines.take_while(|line| !line.contains("KEYS ON OTHER SCREENS")).map(str::to_owned).collect();
    stage.keys(now, "?");
    lines
}

/// The names in the left column of the help.
fn names(lines: &[String]) -> Vec<String> {
    let headings = ["COLUMNS AND FIGURES", "LISTS AND NUMBERS", "THE HEADER", "THE BANNER"];
    let is_heading = |line: &&String| headings.iter().any(|heading| line.trim_start().starts_with(heading));
    let left =
        lines.iter().filter(|line| !is_heading(line)).map(|line| line.chars().take(16).collect::<String>());
    left.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
}

/// The words of at most four letters of plain English that the screens use. Other such words are abbreviations.
const PLAIN: &str = "down left this time ago all and at back by can cell dead done each fill for gave go goes has \
                     held help here in is it its keep kept lane last late lost most next no node not now of ok on \
                     open out over port row run runs seen send sent sort task the they took up vain wait was were \
                     what with yet quit risk a b c e q s x";
/// The names of the sample cells and of a key, and beginnings of names in the heads of a matrix.
const NAMES: &str = "imrs nl nr nh xnh armL armR beam beat lift halt hois tas Esc";

#[test]
fn every_short_word_of_a_screen_is_english_or_explained() {
    let mut unknown = BTreeSet::new();
    for (keys, _) in SCREENS {
        for (mut stage, now) in stages() {
            let shown = stage.typed(now, (200, 60), keys);
            stage.typed(now, (200, 60), "1");
            let known = names(&explained(&mut stage, now, keys, 200)).join(" ");
            let is_known = |word: &str| {
                let mut plain = PLAIN.split_whitespace().filter(|plain| plain.eq_ignore_ascii_case(word));
                let mut exact = NAMES.split(' ').chain(known.split(|c: char| !c.is_alphanumeric()));
                plain.next().is_some() || exact.any(|name| name == word)
            };
            let words = shown.split(|c: char| !c.is_alphanumeric() && c != '_');
            let short = words.filter(|word| {
                word.len() <= 4
                    && word.chars().all(char::is_alphabetic)
                    && word.chars().any(char::is_lowercase)
            });
            unknown.extend(short.filter(|word| !is_known(word)).map(|word| format!("{keys}: {word}")));
        }
    }
    assert!(unknown.is_empty(), "neither plain English nor in the help: {unknown:?}");
}

/// Figures that are no words: where they are shown, and what the help calls them.
#[test]
fn the_help_explains_figures_that_are_no_words() {
    let mut restarted = Stage::busy(Theme::ASCII);
    restarted.lose(ms(1_110), 2);
    restarted.attach(ms(1_120), 2, 2);
    let mut pinged = Stage::busy(Theme::ASCII);
    for node in 0..3 {
        let pong = Pong { echo_us: 1_100_000, mono_us: 5_100_000 };
        pinged.frame(ms(1_120), node, ServerFrame::Pong(pong));
    }
    let busy = || Stage::busy(Theme::ASCII);
    let crowd = || Stage::crowd_at_work(Theme::ASCII);
    let cases = [
        (busy(), ms(1_150), "j", (80, 12), "2/14", "37/156"),
        (restarted, ms(1_150), "", (120, 40), "inc 2, 1 death", "inc 9, 8 deaths"),
        (busy(), NOW, "", (120, 40), " (pid ", "pid"),
        (pinged, ms(1_150), "4", (120, 40), "clocks +-", "clocks +-59ms"),
        (busy(), NOW, "4", (120, 40), "each event", "100ms a row"),
        (busy(), NOW, "4---", (120, 40), " a row", "100ms a row"),
        (crowd(), CROWD_NOW, "4", (64, 20), " >34", "3< >32"),
        (crowd(), CROWD_NOW, "6kk", (120, 40), "+2 new", "+2 new"),
        (crowd(), CROWD_NOW, "7", (120, 40), "(20%)", "5/34 (17%)"),
    ];
    for (mut stage, now, keys, size, figure, name) in cases {
        let shown = stage.typed(now, size, keys);
        assert!(shown.contains(figure), "{keys}: {figure}: {shown}");
        let screen = &keys[..keys.len().min(1)].replace('j', "");
        stage.typed(now, (200, 60), "1");
        let lines = explained(&mut stage, now, screen, 200);
        assert!(names(&lines).iter().any(|known| known == name), "{keys}: {name}: {lines:#?}");
    }
}

/// On a narrow screen a name that has no room beside its explanation stands above it.
#[test]
fn the_help_cuts_no_name() {
    for (keys, _) in SCREENS {
        let wide = names(&explained(&mut Stage::busy(Theme::ASCII), ms(1_150), keys, 200));
        assert!(wide.len() > 20, "{wide:?}");
        for width in [40, 50, 59, 60, 80] {
            let narrow = explained(&mut Stage::busy(Theme::ASCII), ms(1_150), keys, width);
            for name in &wide {
                let is_whole = |line: &String| {
                    line.trim_start()
                        .strip_prefix(name)
                        .is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
                };
                assert!(narrow.iter().any(is_whole), "{keys} at {width}: {name}: {narrow:#?}");
            }
        }
    }
}

/// Visits the texts of all screens. A new abbreviation without a line in the help makes this test fail.
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
            let known: BTreeSet<String> = names(&explained(&mut stage, now, keys, 200))
                .join("\n")
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
            // The title is marked at its place on the screen.
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
        // Back on the screen the title is still selected. Another key ends the selection; Esc does nothing else.
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
