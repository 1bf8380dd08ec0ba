//! Tests of the problems screen: one list over all nodes, with causes first, and the screens that its keys open.

use crate::common::{BEAT, Stage, beam, ms};
use crossterm::event::{KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::{Msg, Screen};
use imrs_monitor::store::health::codes;
use imrs_monitor::store::nearest::nearest;
use imrs_monitor::theme::Theme;
use imrs_protocol::TaskId;

fn dead() -> Stage {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_110), 2);
    stage.keys(ms(3_000), "8");
    stage
}

/// The first row that contains a word, below the titles.
fn row(shown: &str, word: &str) -> usize {
    shown.lines().position(|line| line.contains(word)).unwrap_or_else(|| panic!("no {word}: {shown}"))
}

#[test]
fn a_cause_stands_above_what_it_causes_and_findings_above_messages() {
    let shown = dead().text(ms(3_000), 120, 40);
    let dead = row(&shown, "node-dead");
    assert!(dead < row(&shown, "rendezvous-lost-member"), "{shown}");
    let consequence = shown.lines().nth(dead + 1).unwrap();
    assert!(consequence.contains(" > nl.armL.lift") && consequence.contains("waits in vain"), "{shown}");
    assert!(row(&shown, "rendezvous-lost-member") < row(&shown, "next deadline"), "{shown}");
}

#[test]
fn the_message_with_the_least_to_spare_comes_first() {
    let stage = Stage::busy(Theme::ASCII);
    let found = nearest(stage.app.store(), &beam(), ms(1_101), 40);
    let numbers: Vec<u32> = found.iter().map(|near| near.message.unwrap().1.sequence.get()).collect();
    assert_eq!(numbers, [8812, 8813, 8815]);
    assert!(found.iter().all(|near| (near.task, near.port) == (TaskId(1), BEAT)));
    assert_eq!(nearest(stage.app.store(), &beam(), ms(1_101), 2).len(), 2);
}

#[test]
fn enter_leads_to_what_the_row_is_about() {
    for (word, screen) in [
        ("node-dead", Screen::Overview),
        ("rendezvous-lost-member", Screen::Rendezvous),
        ("#1.8813 of armL", Screen::Port),
    ] {
        let mut stage = dead();
        let first = row(&stage.text(ms(3_000), 120, 40), "PROBLEM") + 1;
        for _ in 0..row(&stage.text(ms(3_000), 120, 40), word) - first {
            stage.keys(ms(3_000), "j");
        }
        let shown = stage.text(ms(3_000), 120, 40);
        assert!(shown.lines().any(|line| line.starts_with('>') && line.contains(word)), "{shown}");
        stage.keys(ms(3_000), "\n");
        assert_eq!(stage.app.screen, screen, "{word}");
        if screen == Screen::Port {
            let shown = stage.text(ms(3_000), 120, 40);
            assert!(shown.lines().any(|line| line.starts_with('>') && line.contains("#1.8813")), "{shown}");
        }
    }
}

#[test]
fn the_page_of_a_code_opens_and_closes() {
    let mut stage = dead();
    stage.keys(ms(3_000), "x");
    assert_eq!(stage.app.screen, Screen::Explain);
    let lint = codes::find("node-dead").unwrap();
    let shown = stage.text(ms(3_000), 80, 24);
    assert!(shown.contains(&format!("node-dead: {}", lint.title)) && shown.contains("What to do"), "{shown}");
    assert!(shown.lines().all(|line| line.chars().count() <= 80));
    stage.key(ms(3_000), crossterm::event::KeyCode::Esc);
    assert_eq!(stage.app.screen, Screen::Problems);
    let mut calm = Stage::cell(Theme::ASCII);
    calm.keys(ms(1_001), "Gx");
    assert_eq!(calm.app.screen, Screen::Overview);
    assert!(calm.text(ms(1_001), 80, 24).contains("there is no finding here"));
}

#[test]
fn the_selection_follows_its_message_and_a_second_click_opens_it() {
    let mut stage = dead();
    let shown = stage.typed(ms(3_000), (120, 40), "G");
    let last = shown.lines().position(|line| line.starts_with('>')).unwrap();
    assert!(shown.lines().nth(last).unwrap().contains("#1.8815"), "{shown}");
    let kind = MouseEventKind::Down(MouseButton::Left);
    let at = |row: usize| MouseEvent { kind, column: 9, row: row as u16, modifiers: KeyModifiers::NONE };
    stage.app.update(Msg::Mouse(at(last - 1)), ms(3_000));
    let shown = stage.text(ms(3_000), 120, 40);
    assert!(shown.lines().nth(last - 1).unwrap().starts_with('>'), "{shown}");
    assert_eq!(stage.app.screen, Screen::Problems);
    stage.app.update(Msg::Mouse(at(last - 1)), ms(3_000));
    assert_eq!(stage.app.screen, Screen::Port);
}
