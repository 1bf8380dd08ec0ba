//! Tests of the cursor and of Enter on every screen, and of the targets of mouse clicks.

use crate::common::{Stage, ms, text};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::{Effect, Msg, Screen};
use imrs_monitor::theme::Theme;
use std::time::Duration;

const NOW: Duration = ms(1_150);
const SIZE: (u16, u16) = (120, 40);

fn click(stage: &mut Stage, column: usize, row: usize) -> Effect {
    let (column, row) = (u16::try_from(column).unwrap(), u16::try_from(row).unwrap());
    let kind = MouseEventKind::Down(MouseButton::Left);
    stage.app.update(Msg::Mouse(MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE }), NOW)
}

fn drawn(stage: &mut Stage) -> String {
    text(&stage.draw(NOW, SIZE.0, SIZE.1))
}

fn selected(shown: &str) -> usize {
    shown.lines().position(|line| line.starts_with('>')).unwrap_or_else(|| panic!("no cursor: {shown}"))
}

/// The row that contains these words.
fn row_of(shown: &str, words: &str) -> usize {
    shown.lines().position(|line| line.contains(words)).unwrap_or_else(|| panic!("no {words}: {shown}"))
}

/// The screens whose rows are about nodes and tasks: for each, the keys that open it, words in a row, and the task that
/// the overview then selects.
const PLACES: [(&str, &str, &str); 6] = [
    ("3", "armR@nr", "armR"),
    ("3", "lift r12", "lift "),
    ("5", "the others at lift", "armL"),
    ("5", "nh  Timer", "nh (pid"),
    ("7", "hoist ", "hoist"),
    ("2l\n", "sent   ", "beat"),
];

#[test]
fn every_screen_has_a_cursor_and_enter_leads_to_what_the_row_is_about() {
    for (keys, words, place) in PLACES {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.typed(NOW, SIZE, keys);
        let screen = stage.app.screen;
        let shown = drawn(&mut stage);
        let (first, wanted) = (selected(&shown), row_of(&shown, words));
        for step in 1..=wanted - first {
            let moved = stage.typed(NOW, SIZE, "j");
            assert_eq!(selected(&moved), first + step, "{keys}: {moved}");
        }
        stage.key(NOW, KeyCode::Enter);
        let shown = drawn(&mut stage);
        assert_eq!(stage.app.screen, Screen::Overview, "{keys}");
        let line = shown.lines().nth(selected(&shown)).unwrap();
        assert!(line.contains(place), "{keys}: {line}");
        // With the mouse, a click selects a row, and a click on the selected row opens it.
        let mut stage = Stage::busy(Theme::ASCII);
        stage.typed(NOW, SIZE, keys);
        stage.key(NOW, KeyCode::End);
        drawn(&mut stage);
        click(&mut stage, 30, wanted);
        let shown = drawn(&mut stage);
        assert_eq!((stage.app.screen, selected(&shown)), (screen, wanted), "{keys}");
        click(&mut stage, 30, wanted);
        let shown = drawn(&mut stage);
        assert_eq!(stage.app.screen, Screen::Overview, "{keys}");
        assert!(shown.lines().nth(selected(&shown)).unwrap().contains(place), "{keys}");
    }
}

/// The keys to each screen.
const SCREENS: [(Screen, &str); 12] = [
    (Screen::Overview, "1"),
    (Screen::Port, "2l"),
    (Screen::Message, "2l\n"),
    (Screen::Rendezvous, "3"),
    (Screen::Timeline, "4"),
    (Screen::Timers, "5"),
    (Screen::Events, "6"),
    (Screen::Model, "7"),
    (Screen::Problems, "8"),
    (Screen::Explain, "8x"),
    (Screen::Settings, "o"),
    (Screen::Help, "?"),
];

/// Exactly one row has the cursor's sign, and Enter acts on that row. This also holds on a narrow screen, and while
/// the events and the timeline follow new rows.
#[test]
fn every_screen_shows_where_enter_acts() {
    let known: Vec<_> = SCREENS.iter().map(|(screen, _)| *screen).collect();
    assert_eq!(known, Screen::ALL);
    for size in [(40, 12), (64, 20), (80, 24), SIZE] {
        for (screen, keys) in SCREENS {
            let mut stage = Stage::busy(Theme::ASCII);
            let shown = stage.typed(NOW, size, keys);
            // The window of the settings has a cursor of its own, and covers the screen behind it, which has another cursor.
            let sign = if screen == Screen::Settings { "|>" } else { ">" };
            let has_sign = |line: &&str| {
                if sign == ">" { line.starts_with(sign) } else { line.contains(sign) }
            };
            let signs = shown.lines().filter(has_sign).count();
            assert_eq!((stage.app.screen, signs), (screen, 1), "{size:?}: {shown}");
            let buffer = stage.draw(NOW, size.0, size.1);
            let row = shown.lines().position(|line| has_sign(&line)).unwrap();
            let middle = &buffer[(size.0 / 2, u16::try_from(row).unwrap())];
            assert!(middle.modifier.contains(ratatui::style::Modifier::REVERSED), "{shown}");
            stage.key(NOW, KeyCode::Enter);
            assert_ne!(text(&stage.draw(NOW, size.0, size.1)), shown, "{screen:?}: Enter is seen");
        }
    }
    let mut stage = Stage::busy(Theme::ASCII);
    let shown = stage.typed(NOW, (40, 12), "2l\n");
    assert!(shown.lines().nth(selected(&shown)).unwrap().starts_with(">armL@nl "), "{shown}");
}

/// Up from the first row of every list is the banner, and Enter there goes to what blocks the cell.
#[test]
fn the_cursor_reaches_the_banner() {
    let later = ms(3_000);
    for (screen, keys) in SCREENS {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.lose(ms(1_500), 2);
        let first = stage.typed(later, (80, 24), keys);
        let up = "k".repeat(if matches!(screen, Screen::Events | Screen::Timeline) { 40 } else { 1 });
        let shown = stage.typed(later, (80, 24), &up);
        assert!(shown.lines().nth(1).unwrap().starts_with(">BLOCKED BY hoist@nh"), "{screen:?}: {shown}");
        let rows = shown.lines().skip(2);
        assert!(!rows.into_iter().any(|line| line.starts_with('>') || line.contains("|>")), "{shown}");
        // Down leads back to the first row, and a step up again to the banner.
        let down = stage.typed(later, (80, 24), "j");
        assert!(!down.lines().nth(1).unwrap().starts_with('>'), "{screen:?}");
        // The bottom line has the finding of the first row once the user has selected that row.
        let list = |shown: &str| shown.lines().take(23).map(str::to_owned).collect::<Vec<_>>();
        assert!(up.len() > 1 || list(&down) == list(&first), "{screen:?}: {down}");
        stage.typed(later, (80, 24), "kk");
        stage.key(later, KeyCode::Enter);
        let shown = text(&stage.draw(later, 80, 24));
        assert_eq!(stage.app.screen, Screen::Overview, "{screen:?}");
        assert!(shown.lines().nth(selected(&shown)).unwrap().contains("hoist"), "{screen:?}: {shown}");
    }
    // The wheel stays within the list, and without a block there is nothing above the first row.
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_500), 2);
    stage.draw(later, 80, 24);
    let event = |kind| Msg::Mouse(MouseEvent { kind, column: 9, row: 9, modifiers: KeyModifiers::NONE });
    stage.app.update(event(MouseEventKind::ScrollUp), later);
    assert!(!stage.app.is_on_banner());
    let mut calm = Stage::new(Theme::ASCII);
    calm.attach(ms(1_000), 2, 1);
    calm.typed(ms(1_100), (80, 24), "kk");
    assert!(!calm.app.is_on_banner());
}

/// What a node did leads to the node, what a task did to the task, and lost events to the node that lost them.
#[test]
fn enter_on_an_event_without_a_message_goes_to_its_place() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_120), 2);
    for (words, place) in
        [("lost   ", " nh "), (" dead ", " nh "), (" attached ", " nl "), ("gave up", "hoist")]
    {
        stage.typed(NOW, SIZE, "6");
        let shown = drawn(&mut stage);
        let row = row_of(&shown, words);
        click(&mut stage, 60, row);
        // The last row is selected while the list follows, so a click on it opens it.
        if stage.app.screen == Screen::Events {
            assert_eq!(selected(&drawn(&mut stage)), row, "{words}");
            stage.key(NOW, KeyCode::Enter);
        }
        let shown = drawn(&mut stage);
        assert_eq!(stage.app.screen, Screen::Overview, "{words}");
        assert!(shown.lines().nth(selected(&shown)).unwrap().contains(place), "{words}: {shown}");
        stage.keys(NOW, "6G");
    }
    stage.typed(NOW, SIZE, "4");
    let shown = drawn(&mut stage);
    click(&mut stage, 60, row_of(&shown, "lift r12 reached"));
    drawn(&mut stage);
    stage.key(NOW, KeyCode::Enter);
    let shown = drawn(&mut stage);
    assert_eq!(stage.app.screen, Screen::Overview);
    assert!(shown.lines().nth(selected(&shown)).unwrap().contains("arm"), "{shown}");
}

#[test]
fn a_row_that_is_about_no_place_says_so() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.typed(NOW, SIZE, "7");
    stage.key(NOW, KeyCode::Enter);
    assert!(drawn(&mut stage).contains("this row is of no node or task"));
    assert_eq!(stage.app.screen, Screen::Model);
}

/// A click on a title explains the column in the words of the help.
#[test]
fn a_click_on_a_title_explains_the_column() {
    for (keys, titles) in [
        ("1", &["NODE/TASK/PORT", "STATE", "QUEUE", "SLACK", "MSG/s", "EXP", "HEALTH"][..]),
        ("2l", &["FROM", "MSG", "REMAIN", "TIME LEFT", "VERDICT"]),
        ("2l\n", &["WHERE", "WHAT", "CHARGED", "CLOCKS"]),
        ("5", &["OWNER", "KIND", "LENGTH", "LEFT", "WHAT"]),
        ("6", &["AGO", "NODE", "OBJECT", "DETAIL"]),
        ("8", &["PLACE", "PROBLEM", "CODE"]),
    ] {
        for title in titles {
            let mut stage = Stage::busy(Theme::ASCII);
            stage.typed(NOW, SIZE, keys);
            let shown = drawn(&mut stage);
            let row =
                shown.lines().position(|line| line.contains(titles[0]) && line.contains(title)).unwrap();
            let column = shown.lines().nth(row).unwrap().find(title).unwrap();
            click(&mut stage, column, row);
            let shown = drawn(&mut stage);
            let foot = shown.lines().last().unwrap();
            assert!(foot.starts_with(&format!(" {title}: ")), "{keys} {title}: {foot}");
        }
    }
    // With the keyboard, a command explains a column. The command also knows the codes of findings.
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, ":explain slack\n");
    assert!(drawn(&mut stage).contains("SLACK: remaining time"));
    stage.keys(NOW, ":explain node-dead\n");
    assert_eq!((stage.app.screen, stage.app.explained()), (Screen::Explain, Some("node-dead")));
}

/// The keys and the most severe finding on the bottom line can be clicked.
#[test]
fn the_bottom_line_can_be_clicked() {
    let mut stage = Stage::busy(Theme::ASCII);
    let shown = drawn(&mut stage);
    let foot = shown.lines().last().unwrap();
    let (help, sort) = (foot.find("? help").unwrap(), foot.find("s sort").unwrap());
    click(&mut stage, sort + 1, 39);
    assert_eq!(stage.app.shape.sort, imrs_monitor::rows::Sort::Slack);
    drawn(&mut stage);
    click(&mut stage, help + 1, 39);
    assert_eq!(stage.app.screen, Screen::Help);
    let mut stage = Stage::busy(Theme::ASCII);
    stage.typed(NOW, SIZE, "6");
    click(&mut stage, 3, 39);
    let shown = drawn(&mut stage);
    assert_eq!(stage.app.screen, Screen::Overview);
    assert!(shown.lines().nth(selected(&shown)).unwrap().contains("beat"), "{shown}");
    // A click on the verdict below the overview opens the model screen.
    let row = row_of(&shown, "model: UNKNOWN");
    let column = shown.lines().nth(row).unwrap().find("UNKNOWN").unwrap();
    click(&mut stage, column, row);
    assert_eq!(stage.app.screen, Screen::Model);
}

#[test]
fn a_click_selects_an_event_and_a_second_one_opens_its_message() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.typed(NOW, SIZE, "6");
    let shown = drawn(&mut stage);
    let row = row_of(&shown, "expired_on_the_way");
    click(&mut stage, 20, row);
    assert!(stage.app.held.is_some());
    drawn(&mut stage);
    click(&mut stage, 20, row);
    assert_eq!(stage.app.message().map(|key| key.number), Some(6));
}

/// A line that is open while the user clicks elsewhere belongs to the screen on which it was opened.
#[test]
fn a_click_ends_the_typing_of_a_filter() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "/halt");
    let shown = drawn(&mut stage);
    let tab = shown.lines().next().and_then(|line| line.find(" 6 ")).expect("the tab");
    click(&mut stage, tab + 1, 0);
    let events = stage.app.events().len();
    stage.keys(NOW, "z");
    assert_eq!(
        (stage.app.screen, stage.app.filter(), stage.app.events().len()),
        (Screen::Events, "", events)
    );
    stage.key(NOW, KeyCode::Esc);
    stage.keys(NOW, "1");
    assert_eq!(stage.app.filter(), "halt");
    stage.keys(NOW, ":port");
    assert!(matches!(click(&mut stage, usize::from(SIZE.0) - 1, usize::from(SIZE.1) - 4), Effect::Draw));
    stage.keys(NOW, "6");
    assert_eq!(stage.app.screen, Screen::Events, "keys are keys again");
}
