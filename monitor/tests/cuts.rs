//! Tests of cut links: one node sends, and the other one receives nothing. The monitor must then name the link, and
//! no task.

use crate::common::{Stage, beam, codes, ms, snapshot};
use crossterm::event::{KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::store::blocked::{Kind, blockers};
use imrs_monitor::store::cuts::cuts;
use imrs_monitor::theme::Theme;
use imrs_protocol::NodeId;
use imrs_wire::obs::{Count, LinkView, ServerFrame, Snapshot};

/// A state of a node at `at` milliseconds: the number of packets that it has sent to its peer, and for how long it
/// has received none.
fn state(node: usize, at: u64, sent: u64, silent_ms: u64) -> Snapshot {
    let peer = NodeId(u16::from(node == 0));
    let mut state = snapshot(node);
    state.mono_us = 5_000_000 + 1_000 * at;
    state.links = vec![LinkView { peer, heard_us: Some(1_000 * silent_ms), sent, received: 9 }];
    state
}

/// Simulates both arms' nodes from second 1 on. `of` gets a node and the milliseconds since then. It returns how many
/// packets the node has sent, and for how many milliseconds it has received none.
fn run(stage: &mut Stage, from: u64, to: u64, of: impl Fn(usize, u64) -> (u64, u64)) {
    for at in (from..to).step_by(100) {
        for node in 0..2 {
            let (sent, silent) = of(node, at);
            stage.frame(ms(1_000 + at), node, ServerFrame::Snapshot(state(node, at, sent, silent)));
        }
    }
}

/// The link from the left arm's node is cut after a second; it goes on sending three packets a second.
fn cut(node: usize, at: u64) -> (u64, u64) {
    (3 * at / 1_000, if node == 1 { at.saturating_sub(1_000) } else { 20 })
}

#[test]
fn what_is_sent_and_does_not_arrive_is_a_cut_link() {
    let mut stage = Stage::cell(Theme::ASCII);
    run(&mut stage, 0, 3_900, cut);
    assert_eq!(cuts(stage.app.store(), &beam(), ms(4_900)).len(), 0, "too few packets so far");
    run(&mut stage, 3_900, 7_000, cut);
    let now = ms(8_000);
    let found = cuts(stage.app.store(), &beam(), now);
    let [found] = &found[..] else { panic!("{found:?}") };
    assert_eq!((found.from.node.raw(), found.to.node.raw()), ("nl", "nr"));
    assert!(found.sent >= 14 && found.silent >= ms(5_900), "{found:?}");
    assert!(codes(stage.app.store(), now).contains(&"link-cut"));
    // The cut is the first blocker on every screen. The tasks that wait over the cut link are no wait cycle and no cause.
    let blocked = blockers(stage.app.store(), &beam(), now);
    assert_eq!(blocked[0].kind, Kind::Cut);
    for size in [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)] {
        for key in ["1", "3", "8"] {
            let shown = stage.typed(now, size, key);
            let banner = shown.lines().nth(1).unwrap();
            assert!(banner.starts_with(" LINK CUT nl-nr - nothing passes"), "{size:?}: {banner}");
        }
    }
    let shown = stage.typed(now, (120, 40), "1");
    assert!(shown.contains("nl-nr CUT"), "{shown}");
    assert!(
        shown.lines().any(|line| line.contains("nr (pid") && line.contains("link from nl is cut")),
        "{shown}"
    );
    // A click on the link leads to the end at which nothing arrives.
    let row = shown.lines().position(|line| line.contains("nl-nr CUT")).unwrap();
    let column = shown.lines().nth(row).unwrap().find("nl-nr CUT").unwrap() + 3;
    let (column, row) = (u16::try_from(column).unwrap(), u16::try_from(row).unwrap());
    let kind = MouseEventKind::Down(MouseButton::Left);
    stage.app.update(Msg::Mouse(MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE }), now);
    let shown = stage.text(now, 120, 40);
    assert!(shown.lines().any(|line| line.starts_with("> - nr (pid")), "{shown}");
    // So does Enter on its row of the problems, and `x` shows the page about its code.
    let problems = stage.typed(now, (120, 40), "8g");
    let row = problems.lines().find(|line| line.starts_with('>')).unwrap();
    assert!(row.contains(" nr ") && row.contains("link from nl is cut") && row.contains("link-cut"), "{row}");
    let page = stage.typed(now, (120, 40), "x");
    assert!(page.lines().any(|line| line.starts_with(">link-cut: ")), "{page}");
    for keys in ["\n", "8g\n"] {
        let shown = stage.typed(now, (120, 40), keys);
        assert!(shown.lines().any(|line| line.starts_with("> - nr (pid")), "{keys}: {shown}");
        stage.typed(now, (120, 40), "g");
    }
    // As soon as a packet arrives again, the link does not count as cut any more.
    run(&mut stage, 7_000, 7_200, |_, at| (3 * at / 1_000, 20));
    assert_eq!(cuts(stage.app.store(), &beam(), ms(8_200)).len(), 0);
}

#[test]
fn a_quiet_link_and_packets_on_their_route_are_no_cut() {
    // If no packets are sent, no link counts as cut.
    let mut stage = Stage::cell(Theme::ASCII);
    run(&mut stage, 0, 9_000, |_, at| (3, at));
    assert_eq!(cuts(stage.app.store(), &beam(), ms(10_000)).len(), 0);
    // Packets that are sent in a burst later make the link count as cut only if none has arrived two seconds later.
    let burst = |_, at: u64| (if at < 9_000 { 3 } else { 30 }, at);
    run(&mut stage, 9_000, 10_900, burst);
    assert_eq!(cuts(stage.app.store(), &beam(), ms(11_900)).len(), 0);
    run(&mut stage, 10_900, 11_500, burst);
    assert_eq!(cuts(stage.app.store(), &beam(), ms(12_500)).len(), 2);
    // Four lost packets may be lost by chance.
    let mut stage = Stage::cell(Theme::ASCII);
    run(&mut stage, 0, 9_000, |_, at| (if at < 2_000 { 3 } else { 7 }, at));
    assert_eq!(cuts(stage.app.store(), &beam(), ms(10_000)).len(), 0);
}

#[test]
fn a_node_that_drops_or_was_stopped_has_no_cut_link() {
    // The counter `other_statements` shows that datagrams arrive and are dropped. The other two counters do not show
    // that, so the link still counts as cut.
    for name in ["other_statements", "send_refused", "stale_session"] {
        let mut stage = Stage::cell(Theme::ASCII);
        for at in (0..7_000).step_by(100) {
            for node in 0..2 {
                let (sent, silent) = cut(node, at);
                let mut state = state(node, at, sent, silent);
                state.link_discards = vec![Count { name: name.into(), count: at }];
                stage.frame(ms(1_000 + at), node, ServerFrame::Snapshot(state));
            }
        }
        assert_eq!(
            cuts(stage.app.store(), &beam(), ms(8_000)).len(),
            usize::from(name != "other_statements"),
            "{name}"
        );
    }
    // The process of the right arm's node is suspended from 1 s to 6 s.
    let mut stage = Stage::cell(Theme::ASCII);
    for at in (0..6_000).step_by(100) {
        for node in 0..if at < 1_000 { 2 } else { 1 } {
            let (sent, silent) = cut(node, at);
            stage.frame(ms(1_000 + at), node, ServerFrame::Snapshot(state(node, at, sent, silent)));
        }
    }
    run(&mut stage, 6_000, 7_900, cut);
    assert_eq!(cuts(stage.app.store(), &beam(), ms(8_800)).len(), 0, "it may not have read them yet");
    run(&mut stage, 7_900, 10_900, cut);
    assert_eq!(cuts(stage.app.store(), &beam(), ms(11_800)).len(), 1);
}
