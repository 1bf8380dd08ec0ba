//! Tests of the line that the user types after `/` or `:`.

use crate::common::{Stage, ms, text};
use crossterm::event::KeyCode;
use imrs_monitor::app::Screen;
use imrs_monitor::theme::Theme;
use std::time::Duration;

const NOW: Duration = ms(1_150);

fn foot(stage: &mut Stage, width: u16) -> String {
    text(&stage.draw(NOW, width, 24)).lines().last().unwrap().to_owned()
}

fn line(stage: &Stage) -> String {
    stage.app.entry_line.as_ref().map_or_else(String::new, |entry| entry.input.value().to_owned())
}

fn press(stage: &mut Stage, codes: &[KeyCode]) {
    for code in codes {
        stage.key(NOW, *code);
    }
}

#[test]
fn the_cursor_moves_within_the_line() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, ":port bat");
    press(&mut stage, &[KeyCode::Left, KeyCode::Left, KeyCode::Char('e')]);
    assert_eq!(line(&stage), "port beat");
    press(
        &mut stage,
        &[KeyCode::Home, KeyCode::Delete, KeyCode::Char('P'), KeyCode::End, KeyCode::Backspace],
    );
    assert_eq!(line(&stage), "Port bea");
    stage.ctrl(NOW, 'w');
    assert_eq!(line(&stage), "Port ");
    // The character under the cursor is marked; at the end of the text the cursor is an underscore.
    assert!(foot(&mut stage, 80).starts_with(" :Port _"));
    press(&mut stage, &[KeyCode::Home]);
    let buffer = stage.draw(NOW, 80, 24);
    assert!(buffer[(2, 23)].modifier.contains(ratatui::style::Modifier::REVERSED));
    // When the user opens the filter again, the line begins with the filter.
    press(&mut stage, &[KeyCode::Esc]);
    stage.keys(NOW, "/bet\n/");
    press(&mut stage, &[KeyCode::Left, KeyCode::Char('a'), KeyCode::Enter]);
    assert_eq!(stage.app.filter(), "beat");
}

#[test]
fn up_and_down_go_through_what_was_typed_before() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, ":port beat\n:theme mono\n:theme mono\n:no");
    press(&mut stage, &[KeyCode::Up]);
    assert_eq!(line(&stage), "theme mono");
    press(&mut stage, &[KeyCode::Up, KeyCode::Up, KeyCode::Up]);
    assert_eq!(line(&stage), "port beat", "a line that is repeated is kept once");
    press(&mut stage, &[KeyCode::Down, KeyCode::Down]);
    assert_eq!(line(&stage), "no", "what was being typed comes back");
    press(&mut stage, &[KeyCode::Esc]);
    // Filters and commands have separate histories. While a filter of the history is shown, the rows follow it.
    stage.keys(NOW, "1/beat\n");
    press(&mut stage, &[KeyCode::Esc]);
    stage.keys(NOW, "/");
    assert_eq!(line(&stage), "");
    press(&mut stage, &[KeyCode::Up]);
    assert_eq!((line(&stage).as_str(), stage.app.filter()), ("beat", "beat"));
}

#[test]
fn tab_completes_commands_names_and_fields() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, ":po");
    press(&mut stage, &[KeyCode::Tab]);
    assert_eq!(line(&stage), "port");
    stage.keys(NOW, " be");
    assert!(foot(&mut stage, 80).contains("Tab: beat"));
    press(&mut stage, &[KeyCode::Tab]);
    assert_eq!(line(&stage), "port beat");
    press(&mut stage, &[KeyCode::Tab]);
    let second = line(&stage);
    assert!(second.ends_with(".beat"), "{second}");
    press(&mut stage, &[KeyCode::BackTab]);
    assert_eq!(line(&stage), "port beat");
    press(&mut stage, &[KeyCode::Enter]);
    assert_eq!(stage.app.screen, Screen::Port);
    // In a condition the word before the cursor is completed, and the text after the cursor stays.
    stage.keys(NOW, "1/len>2 and sla<9ms");
    press(&mut stage, &[KeyCode::Left, KeyCode::Left, KeyCode::Left, KeyCode::Left, KeyCode::Tab]);
    assert_eq!(line(&stage), "len>2 and slack<9ms");
    assert_eq!(stage.app.filter(), "len>2 and slack<9ms");
    // If no word completes the text, nothing changes.
    press(&mut stage, &[KeyCode::Esc]);
    stage.keys(NOW, ":port qqq");
    press(&mut stage, &[KeyCode::Tab]);
    assert_eq!(line(&stage), "port qqq");
}

#[test]
fn a_name_that_is_nearly_right_is_found() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, ":port armRbt\n");
    let shown = stage.text(NOW, 120, 24);
    assert!(stage.app.screen == Screen::Port && shown.contains("beat at armR@nr"), "{shown}");
    stage.keys(NOW, ":node hst\n");
    let shown = text(&stage.draw(NOW, 120, 24));
    assert!(shown.lines().any(|line| line.starts_with('>') && line.contains("hoist")), "{shown}");
}

#[test]
fn what_is_wrong_is_said_while_it_is_typed() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "/slak<3ms");
    assert!(foot(&mut stage, 120).contains("did you mean `slack`"));
    press(&mut stage, &[KeyCode::Esc]);
    for (typed, said) in [
        ("frobnicate", "no such command; there are connect, port"),
        ("port xyz", "this cell has no port xyz"),
        ("node xyz", "this cell has no node or task xyz"),
        ("theme pink", "there is no such theme; there are colour"),
        ("connect here", "write unix:PATH or tcp:HOST:PORT"),
    ] {
        stage.keys(NOW, &format!(":{typed}"));
        assert!(foot(&mut stage, 160).contains(said), "{typed}: {}", foot(&mut stage, 160));
        press(&mut stage, &[KeyCode::Esc]);
    }
    // The beginning of a valid command is no error while it is typed.
    for typed in ["", "po", "port", "port be", "theme co", "q"] {
        stage.keys(NOW, &format!(":{typed}"));
        assert_eq!(stage.app.slip(), None, "{typed}");
        press(&mut stage, &[KeyCode::Esc]);
    }
}

/// A command that the line accepts while it is typed is also accepted by Enter.
#[test]
fn a_theme_may_be_abbreviated() {
    let mut stage = Stage::busy(Theme::ASCII);
    for (typed, name) in [("contr", "contrast"), ("MONO", "mono"), ("colour", "colour")] {
        stage.keys(NOW, &format!(":theme {typed}"));
        assert_eq!(stage.app.slip(), None, "{typed}");
        press(&mut stage, &[KeyCode::Enter]);
        assert_eq!((stage.app.theme.name, &stage.app.told), (name, &None));
    }
    stage.keys(NOW, ":theme pink");
    assert!(stage.app.slip().is_some());
    press(&mut stage, &[KeyCode::Enter]);
    assert_eq!(stage.app.theme.name, "colour");
}

/// If no row of the screen can match a filter, an error says so while the filter is typed, and after Enter.
#[test]
fn a_filter_that_means_nothing_on_its_screen_says_so() {
    for (keys, typed, said) in [
        ("4", "slack<20ms", Some("no condition works here, so all is shown")),
        ("4", "slak<", Some("no condition works here, so all is shown")),
        ("4", "xyz", Some("nothing has this name, so all is shown")),
        ("4", "armL", None),
        ("4", "NH", None),
        ("4", "bea", None),
        ("6", "fill>80%", Some("an event has no `fill`")),
        ("6", "kind=discard and not state=run", Some("an event has no `state`")),
        ("6", "kind=discard and peer=armL", None),
        ("1", "kind=discard", Some("a row has no `kind`")),
        ("1", "fill>80% or slack<1s", None),
    ] {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.keys(NOW, &format!("{keys}/{typed}"));
        let slip = stage.app.slip();
        assert_eq!(slip.is_some(), said.is_some(), "{typed}: {slip:?}");
        assert!(foot(&mut stage, 160).contains(said.unwrap_or_default()), "{typed}");
        press(&mut stage, &[KeyCode::Enter]);
        let told = stage.app.told.clone().unwrap_or_default();
        assert_eq!(told.is_empty(), said.is_none(), "{typed}: {told}");
        assert!(told.contains(said.unwrap_or_default()), "{typed}: {told}");
    }
    // Only words that can match are proposed: no fields on the timeline, and the fields of events on the event
    // screen.
    for (keys, word, proposed) in [("4", "sla", 0), ("6", "pee", 1), ("6", "capa", 0), ("1", "capa", 1)] {
        let mut stage = Stage::busy(Theme::ASCII);
        stage.keys(NOW, &format!("{keys}/{word}"));
        assert_eq!(stage.app.completion().words.len(), proposed, "{word}");
    }
}

/// The input line belongs to the screen on which it was opened, even if another screen is shown meanwhile.
#[test]
fn a_filter_belongs_to_the_screen_on_which_its_line_was_opened() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "/hal");
    stage.app.screen = Screen::Events;
    stage.keys(NOW, "t");
    assert_eq!((stage.app.shape.filter.as_str(), stage.app.filter()), ("halt", ""));
    press(&mut stage, &[KeyCode::Esc]);
    assert_eq!((stage.app.shape.filter.as_str(), stage.app.filter()), ("", ""));
}

#[test]
fn before_a_node_reports_no_name_is_called_wrong() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.keys(NOW, ":port beat\n");
    assert!(stage.text(NOW, 120, 24).contains("no node has reported yet what is in this cell"));
}

#[test]
fn of_a_long_line_the_part_around_the_cursor_is_shown() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.keys(NOW, "/slack<20ms and class=2 and node=nl and task=armL");
    let shown = foot(&mut stage, 40);
    assert!(shown.contains("task=armL_"), "{shown}");
    press(&mut stage, &[KeyCode::Home]);
    let shown = foot(&mut stage, 40);
    assert!(shown.starts_with(" /slack<20ms and"), "{shown}");
}
