//! Tests of the overview: large cells, restarts, sparklines, counters of the last seconds, the scrollbar.

use crate::common::crowd::{CROWD, CROWD_NOW};
use crate::common::{BEAT, Stage, ms, snapshot, text};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::rows::Sort;
use imrs_monitor::store::health::Place;
use imrs_monitor::theme::Theme;
use imrs_protocol::{TaskId, Ticks};
use imrs_wire::obs::{HeldBack, HeldTask, ServerFrame};

fn click(stage: &mut Stage, column: u16, row: u16) {
    let kind = MouseEventKind::Down(MouseButton::Left);
    stage.app.update(Msg::Mouse(MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE }), CROWD_NOW);
}

#[test]
fn of_a_large_cell_one_row_stands_for_the_healthy_nodes() {
    let mut stage = Stage::crowd(Theme::ASCII);
    let shown = text(&stage.draw(CROWD_NOW, 120, 24));
    let rows: Vec<_> = shown.lines().skip(3).take_while(|line| !line.contains(" links ")).collect();
    let named: Vec<_> = rows.iter().filter(|row| !row.trim().is_empty()).collect();
    assert_eq!(named.len(), 3, "the dead node, the one in trouble, and the others: {shown}");
    assert!(shown.contains("x node3") && shown.contains("+ node5"), "{shown}");
    let healthy = rows.iter().find(|row| row.contains("+ 10 nodes")).unwrap();
    assert!(healthy.contains("up: node0, node1, node2") && healthy.ends_with("ok"), "{healthy}");
    // The row of the healthy nodes opens, and the nodes in it are closed.
    stage.keys(CROWD_NOW, "Gl");
    let shown = text(&stage.draw(CROWD_NOW, 120, 24));
    for node in (0..CROWD.nodes).filter(|node| ![3, 5].contains(node)) {
        assert!(shown.contains(&format!("+ node{node} ")), "{node}: {shown}");
    }
    stage.keys(CROWD_NOW, "jl");
    assert!(text(&stage.draw(CROWD_NOW, 120, 24)).contains("- task0"));
    // When the node is closed, the row of the healthy nodes stays selected. It has no name that could be copied.
    stage.keys(CROWD_NOW, "k");
    stage.key(CROWD_NOW, KeyCode::Left);
    assert!(text(&stage.draw(CROWD_NOW, 120, 24)).lines().any(|line| line.starts_with("> + 10 nodes")));
}

#[test]
fn a_node_in_trouble_leaves_the_row_of_the_healthy_ones_and_comes_back() {
    let mut stage = Stage::crowd(Theme::ASCII);
    let count = |stage: &Stage, now| stage.app.healthy(&stage.app.findings(now), now).len();
    assert_eq!(count(&stage, CROWD_NOW), 10);
    stage.lose(ms(9_050), 7);
    assert_eq!(count(&stage, ms(9_100)), 9);
    assert!(text(&stage.draw(ms(9_100), 120, 24)).contains("x node7"));
    stage.crowd_again(ms(9_200), 7, 2);
    assert_eq!(count(&stage, ms(9_250)), 10);
}

/// A node whose task waits for a dead node is not one of the healthy nodes.
#[test]
fn a_node_whose_task_is_held_is_not_counted_as_healthy() {
    let mut stage = Stage::crowd_at_work(Theme::ASCII);
    let blockers = stage.app.blockers(CROWD_NOW);
    let alarming: Vec<_> = blockers.iter().filter(|blocker| blocker.is_alarming()).collect();
    let held: Vec<_> = alarming.iter().flat_map(|blocker| &blocker.by).collect();
    assert_eq!(held.len(), 3, "{blockers:?}");
    let healthy = stage.app.healthy(&stage.app.findings(CROWD_NOW), CROWD_NOW);
    let shown = text(&stage.draw(CROWD_NOW, 120, 40));
    for task in held {
        let node = stage.app.incarnation_of_task(*task).expect("a node");
        assert!(!healthy.contains(&node.id), "{shown}");
        // Its closed row says so, too, unless a finding of the node says more.
        let name = format!("+ {} ", node.node);
        let row =
            shown.lines().find(|line| line.contains(&name)).unwrap_or_else(|| panic!("{name}: {shown}"));
        assert!(row.contains("held by task9@node3") || row.contains("!! lost task9@node3"), "{row}");
    }
}

/// If the user sorts by an amount, or filters, each node has a row of its own, so that nodes can be compared.
#[test]
fn a_filter_and_an_order_by_amounts_show_each_node() {
    for keys in ["s", "ss", "/node\n"] {
        let mut stage = Stage::crowd(Theme::ASCII);
        stage.keys(CROWD_NOW, keys);
        let rows = stage.app.rows(&stage.app.findings(CROWD_NOW), CROWD_NOW);
        assert!(!rows.iter().any(|row| row.place == Place::HEALTHY), "{keys}");
        let nodes = rows.iter().filter(|row| row.depth == 0).count();
        assert_eq!(nodes, usize::from(CROWD.nodes), "{keys}");
    }
    let mut stage = Stage::crowd(Theme::ASCII);
    stage.keys(CROWD_NOW, "sss");
    assert_eq!(stage.app.shape.sort, Sort::Health);
    assert_eq!(stage.app.healthy(&stage.app.findings(CROWD_NOW), CROWD_NOW).len(), 10);
}

#[test]
fn a_command_shows_a_node_that_was_folded() {
    let mut stage = Stage::crowd(Theme::ASCII);
    stage.keys(CROWD_NOW, ":task task30\n");
    let shown = text(&stage.draw(CROWD_NOW, 120, 24));
    let selected = shown.lines().find(|line| line.starts_with('>')).unwrap();
    assert!(selected.contains("task30"), "{shown}");
}

/// A cell whose first node has been started nine times, and then sends its state each second.
fn restarted() -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    for incarnation in 2..10 {
        stage.lose(ms(1_100), 0);
        stage.attach(ms(1_110), 0, incarnation);
    }
    stage
}

/// The row of a node.
fn row_of(shown: &str, node: &str) -> String {
    let row = shown.lines().skip(2).find(|line| line.split_whitespace().any(|word| word == node));
    row.unwrap_or_else(|| panic!("{shown}")).to_owned()
}

#[test]
fn the_row_of_a_restarted_node_says_which_incarnation_it_is_and_how_many_died() {
    let stage = restarted();
    for width in 40..=200 {
        let shown = stage.text(ms(1_150), width, 24);
        assert!(row_of(&shown, "nl").contains(" inc 9, 8 deaths "), "{width}: {shown}");
    }
    for width in [120, 200] {
        let shown = stage.text(ms(1_150), width, 24);
        assert!(row_of(&shown, "nl").contains(" inc 9, 8 deaths up 4m12s "), "{width}: {shown}");
    }
    // The row also names the earlier incarnation while the node is dead or held back.
    let mut dead = restarted();
    dead.lose(ms(1_120), 0);
    for width in 40..=200 {
        let row = row_of(&dead.text(ms(1_150), width, 24), "nl");
        assert!(width < 60 || row.contains("DEAD"), "{width}: {row}");
        assert!((60..80).contains(&width) || row.contains("8 deaths"), "{width}: {row}");
    }
    let mut held = restarted();
    let tasks = vec![HeldTask { task: TaskId(0), remaining: Ticks(61_400_000) }];
    held.frame(ms(1_120), 0, ServerFrame::HeldBack(HeldBack { mono_us: 5_000_000, tasks }));
    for width in 40..=200 {
        let row = row_of(&held.text(ms(1_150), width, 24), "nl");
        assert!(row.contains("8 deaths") && (width < 60 || row.contains("held back")), "{width}: {row}");
    }
    // A node that says goodbye does not count as dead.
    let mut stage = Stage::cell(Theme::ASCII);
    let bye = imrs_wire::obs::Bye { reason: imrs_wire::obs::Goodbye::Stopping };
    stage.frame(ms(1_100), 0, ServerFrame::Bye(bye));
    stage.attach(ms(1_110), 0, 2);
    assert!(stage.text(ms(1_150), 120, 24).contains("inc 2 up"));
}

/// A state that is too long is left out in whole texts: a countdown or a number that is cut would be wrong.
#[test]
fn the_state_of_a_node_is_never_cut_in_a_word() {
    let whole = Stage::busy(Theme::ASCII);
    for width in 60..=200 {
        let row = row_of(&whole.text(ms(1_150), width, 24), "nr");
        assert!(
            row.contains(" up 4m12s ") && row.contains("tr") == row.contains(" transit 1 "),
            "{width}: {row}"
        );
    }
}

/// Counters that have grown in the last five seconds are shown with `+`; other counters are shown as their count since
/// the start.
#[test]
fn counters_say_what_was_added_in_the_last_five_seconds() {
    let mut stage = Stage::cell(Theme::ASCII);
    let expired = |stage: &Stage, now| {
        let shown = stage.text(now, 120, 40);
        let row = shown.lines().filter(|line| line.contains(" beat ")).nth(1).unwrap().to_owned();
        row.split_whitespace().nth(9).unwrap().to_owned()
    };
    assert_eq!(expired(&stage, ms(1_050)), "2");
    let mut state = snapshot(1);
    for second in 1..=12 {
        let beat = state.tasks[0].view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
        beat.counters.expired += u64::from(second <= 3);
        state.mono_us += 1_000_000;
        let now = ms(1_000 + 1_000 * second);
        stage.frame(now, 1, ServerFrame::Snapshot(state.clone()));
        let said = expired(&stage, now);
        let least = [3, 2, 1].iter().find(|n| said == format!("+{n}"));
        match second {
            1..=3 => assert_eq!(said, format!("+{second}"), "{second}"),
            4..=5 => assert_eq!(said, "+3", "{second}"),
            6..=7 => assert!(least.is_some(), "{second}: {said}"),
            8 => {}
            _ => assert_eq!(said, "5", "{second}"),
        }
    }
}

/// A node sends sixty states with growing traffic, so its sparkline rises.
#[test]
fn each_node_has_a_line_of_its_traffic_and_of_its_slack() {
    let mut stage = Stage::cell(Theme::COLOUR);
    let mut state = snapshot(1);
    for second in 1..=12_u64 {
        state.mono_us += 1_000_000;
        let beat = state.tasks[0].view.ports.iter_mut().find(|p| p.port == BEAT).unwrap();
        beat.counters.delivered += 10 * second;
        beat.min_slack = Some(imrs_protocol::Ticks(100_000 * (13 - second)));
        stage.frame(ms(1_000 + 1_000 * second), 1, ServerFrame::Snapshot(state.clone()));
    }
    let shown = stage.text(ms(13_050), 120, 24);
    let row = shown.lines().find(|line| line.contains("nr (pid")).unwrap();
    let bars: Vec<char> = row.chars().filter(|c| ('▁'..='█').contains(c)).collect();
    assert!(bars.len() >= 10, "{row}");
    let (traffic, slack) = bars.split_at(bars.len() / 2);
    assert!(traffic.is_sorted() && traffic.first() < traffic.last(), "{row}");
    assert!(slack.iter().rev().is_sorted() && slack.first() > slack.last(), "{row}");
    // For a new node there is nothing to show.
    assert!(!row_of(&stage.text(ms(13_050), 200, 24), "nl").contains('▇'));
}

/// Sparklines of a restarted node have room beside its longer state, also on a screen of 80 columns while all is well.
#[test]
fn a_restarted_node_has_lines_of_its_traffic_too() {
    let mut stage = restarted();
    let mut state = snapshot(0);
    for second in 1..=12_u64 {
        state.mono_us += 1_000_000;
        state.tasks[0].view.ports[1].counters.delivered += 10 * second;
        stage.frame(ms(1_200 + 1_000 * second), 0, ServerFrame::Snapshot(state.clone()));
    }
    for width in [120, 200] {
        let row = row_of(&stage.text(ms(13_250), width, 24), "nl");
        let beside = row.split_once("8 deaths").unwrap().1.split_once("0/2").unwrap().0;
        let line = beside.split_whitespace().next_back().unwrap();
        assert!(line.len() >= 5 && line.chars().is_sorted(), "{width}: {row}");
    }
}

/// The states take what their texts need, and no more: everything else is for the health.
#[test]
fn the_health_has_what_the_other_columns_do_not_need() {
    let mut dead = Stage::busy(Theme::ASCII);
    dead.lose(ms(1_120), 2);
    let crowd = Stage::crowd(Theme::ASCII);
    for (width, least) in [(64, 17), (80, 18), (90, 24), (120, 32), (200, 60)] {
        for (stage, now) in [(&dead, ms(1_700)), (&crowd, CROWD_NOW)] {
            let shown = stage.text(now, width, 40);
            let at = shown.lines().nth(2).unwrap().find("HEALTH").unwrap();
            assert!(usize::from(width) - at >= least, "{width}: {at}: {shown}");
        }
    }
    // The sum of a whole cell is longer than the number of a port, and is not cut.
    assert!(Stage::crowd(Theme::ASCII).text(CROWD_NOW, 80, 24).contains("18/720 "));
}

/// A list with a scrollbar has the columns of a list without one.
#[test]
fn a_scrollbar_takes_no_column_of_the_table() {
    let stage = Stage::cell(Theme::ASCII);
    for width in [60, 80, 90, 116, 160] {
        let titles = |height| {
            let shown = stage.text(CROWD_NOW, width, height);
            let line = shown.lines().nth(2).unwrap();
            line.split_whitespace()
                .filter(|word| !word.contains(char::is_numeric))
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        assert_eq!(titles(12), titles(40), "{width}");
    }
}

#[test]
fn a_list_that_does_not_fit_has_a_scrollbar_and_says_where_one_is() {
    let mut stage = Stage::cell(Theme::ASCII);
    let all = stage.app.rows(&[], CROWD_NOW).len();
    let shown = text(&stage.draw(CROWD_NOW, 80, 12));
    assert!(shown.lines().nth(2).unwrap().ends_with(&format!("1/{all}")), "{shown}");
    stage.keys(CROWD_NOW, "G");
    let shown = text(&stage.draw(CROWD_NOW, 80, 12));
    assert!(shown.lines().nth(2).unwrap().ends_with(&format!("{all}/{all}")), "{shown}");
    let bar: String = shown.lines().skip(3).take(7).filter_map(|line| line.chars().nth(79)).collect();
    assert!(bar.starts_with('|') && bar.ends_with('#'), "{bar}");
    // A click on the beginning of the scrollbar selects the first row, and a click on its end the last row.
    click(&mut stage, 79, 3);
    assert!(text(&stage.draw(CROWD_NOW, 80, 12)).lines().nth(3).unwrap().starts_with('>'));
    click(&mut stage, 79, 9);
    let shown = text(&stage.draw(CROWD_NOW, 80, 12));
    assert!(shown.lines().nth(2).unwrap().ends_with(&format!("{all}/{all}")), "{shown}");
    // If all rows have room, there is neither a scrollbar nor a position.
    let shown = text(&stage.draw(CROWD_NOW, 120, 40));
    assert!(!shown.contains(&format!("/{all}")), "{shown}");
}
