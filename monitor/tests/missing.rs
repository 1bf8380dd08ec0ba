//! Tests of nodes that the cell declares and of which the monitor knows little or nothing.

use crate::common::{LIFT, NODES, Stage, beam, codes, identity, ms, snapshot, table};
use imrs_monitor::query::Assertion;
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::store::health::findings;
use imrs_monitor::store::meeting::{Standing, meeting};
use imrs_monitor::store::{Store, unseen};
use imrs_monitor::theme::Theme;
use imrs_wire::obs::ServerFrame;
use imrs_wire::obs::{Count, NodeIdentity, Snapshot};

#[test]
fn of_a_quiet_cell_only_the_node_that_nobody_saw_is_told() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 0, 1);
    stage.attach(ms(1_000), 2, 1);
    assert_eq!(
        codes(stage.app.store(), ms(1_010)),
        ["node-missing"],
        "nobody knows of the node between them"
    );
    stage.attach(ms(1_000), 1, 1);
    assert!(!codes(stage.app.store(), ms(1_010)).contains(&"node-missing"));
}

#[test]
fn every_node_of_the_table_has_a_row() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 1, 1);
    let text = stage.text(ms(1_000), 120, 24);
    for name in NODES {
        assert!(text.contains(name), "{text}");
    }
    assert!(
        text.contains("1/3 nodes") && text.contains("not seen here") && text.contains("never seen"),
        "{text}"
    );
}

#[test]
fn a_member_on_a_node_never_seen_is_known_through_the_others() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 0, 1);
    let shown = meeting(stage.app.store(), &beam(), LIFT, ms(1_010)).unwrap();
    let standing: Vec<_> = shown.members.iter().map(|m| m.standing).collect();
    assert_eq!(standing, [Standing::Arrived, Standing::Arrived, Standing::Missing]);
    assert!(shown.members[1].presence.is_none());
    assert_eq!(shown.lost().count(), 0, "never seen is not dead");
}

#[test]
fn a_socket_left_behind_says_which_node_was_killed() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 0, 1);
    stage.feed(ms(1_000), 7, Feed::Stale { cell: "beam-lift".into(), node: "nh".into() });
    let unseen = unseen(stage.app.store(), &beam());
    let unseen: Vec<_> = unseen.iter().map(|one| (one.name.raw(), one.is_killed)).collect();
    assert_eq!(unseen, [("nr", false), ("nh", true)]);
    assert!(codes(stage.app.store(), ms(1_000)).contains(&"node-dead"));
}

/// Tests the conditions that scripts use: whether all nodes are up, and whether any finding is critical.
#[test]
fn no_condition_on_a_whole_cell_holds_because_a_node_is_not_there() {
    let mut stage = Stage::new(Theme::ASCII);
    let holds = |stage: &Stage, text: &str| {
        text.parse::<Assertion>().unwrap().holds(stage.app.store(), &[beam()], ms(1_010)).holds
    };
    stage.attach(ms(1_000), 0, 1);
    stage.attach(ms(1_000), 2, 1);
    for text in ["missing==0", "critical==0", "up>=3", "up==nodes", "nodes <= up"] {
        assert!(!holds(&stage, text), "{text}");
    }
    stage.attach(ms(1_000), 1, 1);
    assert!(holds(&stage, "missing==0 and critical==0 and up>=3 and up==nodes and not up < nodes"));
    stage.lose(ms(1_005), 1);
    assert!(holds(&stage, "missing==1"));
}

/// A recording contains only the nodes that were recorded, so it cannot show that other nodes are missing.
#[test]
fn in_a_recording_nobody_is_missing() {
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 0, 1);
    assert!(codes(stage.app.store(), ms(1_010)).contains(&"node-missing"));
    let mut recorded = Store::default();
    let all = [
        Feed::Attached { identity: identity(0, 1), pid: 1, build: "imrs 0.1.0".into() },
        Feed::Frame(Box::new(ServerFrame::Table(table()))),
        Feed::Frame(Box::new(ServerFrame::Snapshot(snapshot(0)))),
    ];
    for feed in all {
        recorded.apply(Arrival { at: ms(1_000), source: SourceId(0), feed });
    }
    assert_eq!(unseen(&recorded, &beam()).len(), 2);
    assert!(!codes(&recorded, ms(1_010)).contains(&"node-missing"));
}

/// Attaches a node whose cell file has this digest. Its links drop the datagrams of nodes with another text.
fn attach_with_text(stage: &mut Stage, node: usize, digest: u32) {
    let identity = NodeIdentity { digest, ..identity(node, 1) };
    stage.feed(ms(1_000), node, Feed::Attached { identity, pid: 800, build: "imrs 0.1.0".into() });
    stage.frame(ms(1_000), node, ServerFrame::Table(table()));
    for (at, count) in [(1_000, 0), (2_000, 4)] {
        let dropped = vec![Count { name: "other_cell".into(), count }];
        let state = Snapshot { link_discards: dropped, ..snapshot(node) };
        stage.frame(ms(at), node, ServerFrame::Snapshot(state));
    }
}

/// The first finding of each node.
fn first_of_each(stage: &Stage) -> Vec<String> {
    let mut found = findings(stage.app.store(), &beam(), ms(2_010));
    found.retain(|f| f.place.task.is_none() && f.code == "digest-mismatch");
    found.dedup_by_key(|f| f.place);
    found.iter().map(|f| f.text.to_string()).collect()
}

#[test]
fn of_two_texts_of_a_cell_both_are_told_before_what_the_links_drop() {
    let mut stage = Stage::new(Theme::ASCII);
    attach_with_text(&mut stage, 0, 7);
    attach_with_text(&mut stage, 1, 9);
    let texts = ["digest 00000007, other nodes have 00000009", "digest 00000009, other nodes have 00000007"]
        .map(|digests| format!("runs another text of the cell: {digests}"));
    assert_eq!(first_of_each(&stage), texts);
    attach_with_text(&mut stage, 2, 9);
    let found = first_of_each(&stage);
    assert_eq!(found[0], texts[0], "one node against two");
    assert!(found[1..].iter().all(|text| text.starts_with("link drops")), "{found:?}");
}
