//! Tests of what nodes report of their links: delays against the declared bounds, and faulty links.

use crate::common::crowd::CROWD_DEATH;
use crate::common::{BEAT, Stage, beam, codes, ms, observed, snapshot};
use crossterm::event::{KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::report;
use imrs_monitor::store::health::{Place, findings};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, NodeId};
use imrs_wire::obs::{Delays, Events, Integrity, LinkReport, LinkReports, LinkView, ServerFrame, TimedEvent};
use serde_json::Value;

/// The declared bound of the link between the arms' nodes, in microseconds.
fn bound(stage: &Stage) -> u64 {
    let incarnation = &stage.app.store().incarnations()[0];
    let names = &incarnation.names;
    let link = names.links.iter().find(|link| (link.a, link.b) == (NodeId(0), NodeId(1))).expect("a link");
    link.delay.0 * incarnation.tick_us
}

/// Node `nr` reports on its link from `nl`: the recent delays, and the damage.
fn reports(stage: &mut Stage, at: u64, recent: Delays, integrity: Integrity) {
    let link = LinkReport {
        peer: NodeId(0),
        delay: Delays { count: recent.count + 1_000, ..recent },
        recent,
        recent_us: 6_000_000,
        unmeasured: 17,
        integrity,
        has_stopped: false,
    };
    let state = snapshot(1);
    let heard = LinkView { peer: NodeId(0), heard_us: Some(20), sent: 4, received: 9 };
    stage.frame(ms(at), 1, ServerFrame::Snapshot(imrs_wire::obs::Snapshot { links: vec![heard], ..state }));
    stage.frame(ms(at), 1, ServerFrame::Links(LinkReports { mono_us: 5_000, links: vec![link] }));
}

fn delays(count: u64, late: u64, p99_us: u64) -> Delays {
    Delays { count, late, p50_us: 90, p99_us, max_us: p99_us }
}

/// The codes of the findings about links, and the row of links on the overview.
fn shown(stage: &mut Stage, at: u64) -> (Vec<&'static str>, String) {
    let codes =
        codes(stage.app.store(), ms(at)).into_iter().filter(|code| code.starts_with("link-")).collect();
    let screen = stage.typed(ms(at), (120, 40), "1");
    let row = screen.lines().find(|line| line.contains(" links ")).expect("the links");
    (codes, row.to_owned())
}

#[test]
fn a_delay_is_shown_beside_its_bound_and_warned_of_when_it_comes_near() {
    let mut stage = Stage::cell(Theme::ASCII);
    let bound = bound(&stage);
    let cases = [
        (delays(500, 0, bound / 2), None),
        (delays(19, 19, 9 * bound), None),
        (delays(500, 0, bound), Some("link-near-bound")),
        (delays(500, 5, 2 * bound), Some("link-near-bound")),
        (delays(500, 6, 2 * bound), Some("link-late")),
    ];
    for (at, (recent, code)) in (2_000..).step_by(100).zip(cases) {
        reports(&mut stage, at, recent, Integrity::default());
        let (codes, row) = shown(&mut stage, at);
        assert_eq!(codes, Vec::from_iter(code), "{recent:?}");
        let word = match code {
            None => "ok",
            Some("link-late") => "late",
            Some(_) => "near",
        };
        let words = format!("nl-nr {word} {}", recent.beside(bound));
        assert!(row.contains(&words), "{words}: {row}");
        let text = report::text(stage.app.store(), None, ms(at));
        let words = format!("\n    link from nl: {} in 6.00s\n", recent.beside(bound));
        assert!(text.contains(&words), "{words}: {text}");
        // A narrow screen shows only the 99th percentile.
        let narrow = stage.typed(ms(at), (80, 24), "1");
        let words = recent
            .briefly_beside(bound)
            .map_or_else(|| " nl-nr ok ".to_owned(), |words| format!("nl-nr {word} {words}"));
        let row = narrow.lines().find(|line| line.contains(" links ")).expect("the links");
        assert!(row.contains(&words) && !row.contains("p50"), "{words}: {row}");
    }
    // An old report is not shown any more.
    let (codes, row) = shown(&mut stage, 6_000);
    assert!(codes.is_empty() && !row.contains('/'), "{row}");
}

/// A link that is down, cut or faulty comes before one that is only late, and is in sight on every screen, beside the verdict.
#[test]
fn a_dead_link_comes_before_a_late_one_and_always_has_room() {
    let mut stage = Stage::cell(Theme::ASCII);
    let bound = bound(&stage);
    reports(&mut stage, 2_000, delays(500, 50, 9 * bound), Integrity::default());
    stage.lose(ms(1_500), 2);
    let dead = CROWD_DEATH + ms(3_000);
    let mut crowd = Stage::crowd_for(Theme::ASCII, 152);
    for width in (40..=160).step_by(4) {
        for (stage, at, words) in
            [(&mut stage, ms(2_100), ["nh DOWN", "UNKNOWN"]), (&mut crowd, dead, ["node3", "UNKNOWN"])]
        {
            let shown = stage.typed(at, (width, 20), "1");
            let row = shown.lines().find(|line| line.contains("  model: ")).expect("the links");
            let all = words.iter().chain(&["DOWN"]).all(|word| row.contains(word));
            assert!(all, "{width}: {row}");
            let (down, late) = (row.find("DOWN"), row.find("late"));
            assert!(late.is_none() || down < late, "{width}: {row}");
        }
    }
}

/// A link of the node, and its timers, are late, too. They name a cause less directly than the port's finding, and
/// may be late by chance. So they never replace the port's finding on the overview.
#[test]
fn a_slight_fault_of_a_link_displaces_nothing_that_a_port_reports() {
    let mut stage = Stage::cell(Theme::ASCII);
    let bound = bound(&stage);
    reports(&mut stage, 1_100, delays(500, 100, 2 * bound), Integrity::default());
    let mut after = snapshot(1);
    let beat = after.tasks[0].view.ports.iter_mut().find(|port| port.port == BEAT).unwrap();
    beat.counters.refused += 1;
    beat.queue.clear();
    (beat.len, beat.min_slack) = (0, None);
    stage.frame(ms(1_200), 1, ServerFrame::Snapshot(after));
    let found = findings(stage.app.store(), &beam(), ms(1_200));
    let codes: Vec<_> = found.iter().map(|finding| finding.code).collect();
    let (first, link) =
        (codes.iter().position(|code| *code == "refused"), codes.iter().position(|c| *c == "link-late"));
    assert!(first.is_some() && link.is_some() && first < link, "{codes:?}");
    assert_eq!(found[link.unwrap()].place, Place { task: None, port: None, ..found[first.unwrap()].place });
    for size in [(64, 20), (80, 24), (120, 40)] {
        let shown = stage.typed(ms(1_200), size, "1");
        let foot = shown.lines().last().unwrap();
        assert!(foot.contains("nr.armR.beat: refused"), "{shown}");
    }
    // The row of the node names the port, too.
    let shown = stage.typed(ms(1_200), (120, 40), "1");
    assert!(shown.lines().any(|line| line.contains(" nr ") && line.contains("! refused")), "{shown}");
    // A more severe finding comes first, whatever it is about.
    assert!(found.is_sorted_by_key(|finding| std::cmp::Reverse(finding.level)));
}

#[test]
fn a_faulty_link_is_a_finding_a_word_beside_the_link_and_one_line_of_the_journal() {
    let mut stage = Stage::cell(Theme::ASCII);
    let integrity = Integrity { failures: 12, is_faulty: true, faults: 1, unmatched: 0 };
    reports(&mut stage, 2_000, delays(0, 0, 0), Integrity { failures: 12, ..Integrity::default() });
    assert_eq!(shown(&mut stage, 2_000).0, [""; 0], "not declared");
    for at in [2_100, 2_200] {
        reports(&mut stage, at, delays(0, 0, 0), integrity);
        let (codes, row) = shown(&mut stage, at);
        assert_eq!(codes, ["link-faulty"]);
        assert!(row.contains("nl-nr FAULTY"), "{row}");
    }
    reports(&mut stage, 2_300, delays(0, 0, 0), Integrity { is_faulty: false, ..integrity });
    assert_eq!(shown(&mut stage, 2_300).0, [""; 0], "it is well again");
    let lines = stage.app.store().journal().lines(false, "");
    assert_eq!(lines.iter().filter(|line| line.kind() == "link faulty").count(), 1);
}

fn selected(shown: &str) -> &str {
    shown.lines().find(|line| line.starts_with('>')).expect("a selected row")
}

/// Enter on an event of a link leads to the node that reported the event. So does Enter on a dropped datagram that
/// belongs to no task.
#[test]
fn enter_on_an_event_of_a_link_leads_to_the_node_that_reported_it() {
    let mut stage = Stage::cell(Theme::ASCII);
    let integrity = Integrity { failures: 12, is_faulty: true, faults: 1, unmatched: 0 };
    reports(&mut stage, 2_000, delays(0, 0, 0), Integrity { failures: 12, ..Integrity::default() });
    reports(&mut stage, 2_100, delays(0, 0, 0), integrity);
    let shown = stage.typed(ms(2_200), (120, 40), "6/link faulty\n");
    assert!(selected(&shown).contains(" nr ") && selected(&shown).contains("link faulty"), "{shown}");
    let shown = stage.typed(ms(2_200), (120, 40), "\n");
    assert!(selected(&shown).starts_with("> - nr (pid"), "{shown}");
    let mut stage = Stage::cell(Theme::ASCII);
    let what = observed(Event::RefusedByPeer, BEAT, 1, 3);
    let dropped = TimedEvent { mono_us: 1_000, task: None, what };
    stage.frame(ms(2_000), 2, ServerFrame::Events(Events { lost: 0, events: vec![dropped] }));
    let shown = stage.typed(ms(2_200), (120, 40), "6");
    assert!(selected(&shown).contains(" nh ") && selected(&shown).contains("refused"), "{shown}");
    let shown = stage.typed(ms(2_200), (120, 40), "\n");
    assert!(selected(&shown).starts_with("> - nh (pid"), "{shown}");
}

/// A click on a late or faulty link leads to the node that receives the datagrams too late, whichever end of the link
/// that is.
#[test]
fn a_click_on_a_link_leads_to_the_end_that_is_in_trouble() {
    let bound = bound(&Stage::cell(Theme::ASCII));
    let damaged = Integrity { failures: 12, is_faulty: true, faults: 1, unmatched: 0 };
    let cases = [
        (delays(500, 0, bound / 2), Integrity::default(), "nl"),
        (delays(500, 6, 2 * bound), Integrity::default(), "nr"),
        (delays(0, 0, 0), damaged, "nr"),
    ];
    for (recent, integrity, end) in cases {
        let mut stage = Stage::cell(Theme::ASCII);
        reports(&mut stage, 2_000, recent, integrity);
        let shown = stage.typed(ms(2_000), (120, 40), "1");
        let row = shown.lines().position(|line| line.contains(" links ")).expect("the links");
        let column = shown.lines().nth(row).unwrap().find("nl-nr").unwrap() + 1;
        let (column, row) = (u16::try_from(column).unwrap(), u16::try_from(row).unwrap());
        let kind = MouseEventKind::Down(MouseButton::Left);
        let click = MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE };
        stage.app.update(Msg::Mouse(click), ms(2_000));
        let shown = stage.text(ms(2_000), 120, 40);
        assert!(selected(&shown).starts_with(&format!("> - {end} (pid")), "{recent:?}: {shown}");
    }
}

#[test]
fn a_node_that_a_neighbour_saw_stop_is_not_dead_and_not_missing() {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.lose(ms(2_000), 0);
    assert!(codes(stage.app.store(), ms(2_100)).contains(&"node-dead"));
    reports(&mut stage, 2_100, delays(0, 0, 0), Integrity::default());
    assert!(codes(stage.app.store(), ms(2_100)).contains(&"node-dead"), "nl said no goodbye");
    let link = LinkReport {
        peer: NodeId(0),
        delay: Delays::default(),
        recent: Delays::default(),
        recent_us: 6_000_000,
        unmeasured: 0,
        integrity: Integrity::default(),
        has_stopped: true,
    };
    let frame = ServerFrame::Links(LinkReports { mono_us: 5_000, links: vec![link] });
    stage.frame(ms(2_200), 1, frame.clone());
    assert!(!codes(stage.app.store(), ms(2_200)).contains(&"node-dead"));
    assert!(shown(&mut stage, 2_200).1.contains("nl-nr STOPPED"));
    // A monitor that started later has never seen the node.
    let mut stage = Stage::new(Theme::ASCII);
    stage.attach(ms(1_000), 1, 1);
    stage.attach(ms(1_000), 2, 1);
    let missing = |stage: &Stage| codes(stage.app.store(), ms(1_200)).contains(&"node-missing");
    assert!(missing(&stage));
    stage.frame(ms(1_100), 1, frame);
    assert!(!missing(&stage));
}

#[test]
fn the_json_has_every_measured_link() {
    let mut stage = Stage::cell(Theme::ASCII);
    let bound = bound(&stage);
    let integrity = Integrity { failures: 3, is_faulty: false, faults: 0, unmatched: 1 };
    reports(&mut stage, 2_000, delays(500, 1, bound), integrity);
    let json: Value = serde_json::from_str(&report::json(stage.app.store(), None, ms(2_000))).expect("JSON");
    let node = |name: &str| {
        json["nodes"]
            .as_array()
            .expect("nodes")
            .iter()
            .find(|node| node["name"] == name)
            .expect("a node")
            .clone()
    };
    let link = &node("nr")["links"][0];
    assert_eq!(
        (&link["from"], &link["bound_us"], &link["margin"]),
        (&"nl".into(), &bound.into(), &"near".into())
    );
    assert_eq!(link["recent"]["p99_us"], bound);
    assert_eq!((&link["delay"]["count"], &link["delay"]["late"]), (&1_500.into(), &1.into()));
    assert_eq!((&link["unmeasured"], &link["integrity"]["unmatched"]), (&17.into(), &1.into()));
    assert_eq!(node("nl")["links"], Value::Array(Vec::new()), "it has reported none");
}
