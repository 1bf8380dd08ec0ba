//! Tests of the problems screen: one list over all nodes, with causes first, and the screens that its keys open.

use crate::common::{BEAT, Stage, beam, cell_with, ms, snapshot};
use crossterm::event::{KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::{Msg, Screen};
use imrs_monitor::store::blocked::{Kind, blockers};
use imrs_monitor::store::health::codes;
use imrs_monitor::store::nearest::nearest;
use imrs_monitor::theme::Theme;
use imrs_protocol::{CellTable, TaskId, TaskState, Ticks};
use imrs_wire::obs::{Liveness, ServerFrame, Table};

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

/// A block of the left arm: it has waited long for the answer of the right arm, which runs.
fn asked() -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    let table = Table::of(&CellTable::new(cell_with(Ticks(2_000_000))).unwrap());
    for node in 0..3 {
        stage.frame(ms(1_000), node, ServerFrame::Table(table.clone()));
        let mut state = snapshot(node);
        let view = &mut state.tasks[0].view;
        view.state = match node {
            0 => TaskState::AwaitingReply { port: BEAT, from: TaskId(1), remaining: Ticks(300_000) },
            _ => TaskState::Running,
        };
        view.meetings.clear();
        for port in &mut view.ports {
            port.queue.clear();
            (port.len, port.min_slack) = (0, None);
        }
        stage.frame(ms(1_000), node, ServerFrame::Snapshot(state));
    }
    stage
}

/// A block that no finding mentions has a row of its own. `x` on this row shows the page about the cause of the
/// block.
#[test]
fn the_page_of_a_block_is_about_its_cause() {
    let mut stage = asked();
    let shown = stage.typed(ms(1_001), (120, 40), "8");
    let first = shown.lines().find(|line| line.starts_with('>')).unwrap();
    assert!(first.contains("armR@nr - holds 1: reply beat") && first.contains("time-outs"), "{shown}");
    stage.keys(ms(1_001), "x");
    assert_eq!((stage.app.screen, stage.app.explained()), (Screen::Explain, Some("time-outs")));
    let code = |stage: &Stage, now| {
        let found = blockers(stage.app.store(), &beam(), now);
        found.iter().map(|blocker| (blocker.kind, blocker.code)).collect::<Vec<_>>()
    };
    // The same wait, if the node of the right arm died, if it sends nothing, or if the task panicked.
    let mut lost = asked();
    lost.lose(ms(1_100), 1);
    assert_eq!(code(&lost, ms(2_000))[0], (Kind::Awaited, "node-dead"));
    let mut silent = asked();
    for node in [0, 2] {
        let mut state =
            silent.app.store().incarnations()[node].last.clone().unwrap().snapshot.as_ref().clone();
        state.mono_us += 3_000_000;
        silent.frame(ms(4_000), node, ServerFrame::Snapshot(state));
    }
    assert_eq!(code(&silent, ms(4_000))[0], (Kind::Awaited, "node-silent"));
    let mut crashed = asked();
    let mut state = crashed.app.store().incarnations()[1].last.clone().unwrap().snapshot.as_ref().clone();
    state.tasks[0].liveness = Liveness::Crashed;
    crashed.frame(ms(1_100), 1, ServerFrame::Snapshot(state));
    assert_eq!(code(&crashed, ms(2_000))[0], (Kind::Awaited, "task-crashed"));
    // A rendezvous, a node for which no task waits, and a cycle.
    let mut late = Stage::cell(Theme::ASCII);
    late.frame(ms(1_100), 0, ServerFrame::Snapshot(snapshot(0)));
    assert_eq!(code(&late, ms(1_600))[0], (Kind::Awaited, "rendezvous-stuck"));
    let mut alone = asked();
    alone.lose(ms(1_100), 2);
    assert!(code(&alone, ms(2_000)).contains(&(Kind::Lost, "node-dead")));
    let cycle = crate::screens::cycle(Theme::ASCII);
    assert_eq!(code(&cycle, ms(1_150))[0], (Kind::Cycle, "wait-cycle"));
    assert!(codes::ALL.iter().any(|lint| lint.code == code(&cycle, ms(1_150))[0].1));
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
