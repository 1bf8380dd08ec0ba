//! Tests of reports and of the summary that several of them give.

use super::*;
use crate::cells::tests::beam_lift;
use crate::fact::{Fact, Fold};
use crate::folds::gatherer::Gatherer;
use crate::launcher::Verdict;
use crate::pipe::{Event, Figures, What, Word};
use imrs_protocol::{NodeId, PortCounters, PortId, Round, TaskId};
use imrs_wire::obs::LinkReport;
use std::sync::Arc;

/// The report of the machine that runs one node. Each of the `rounds` released the node's only task, which sent one
/// message in each round.
fn machine(node: u16, rounds: u16) -> Report {
    let loaded = beam_lift();
    let (id, task) = (NodeId(node), TaskId(node));
    let mut gatherer = Gatherer::new(Arc::clone(&loaded.table), vec![id]);
    let mut take = |fact: Fact| gatherer.take(1, &fact);
    for round in 1..=rounds {
        for what in [What::Announced, What::Released] {
            let event = Event { at: 1, task, port: PortId(0), round: Round(round), what };
            take(Fact::Said(id, Word::Event(event)));
        }
    }
    let sent = PortCounters { sent: rounds.into(), ..PortCounters::default() };
    let figures = Figures { ports: vec![(task, PortId(0), sent)], ..Figures::default() };
    take(Fact::Said(id, Word::Figures(Box::new(figures))));
    gatherer.report((f64::from(rounds), 7, 0.0), &[(id, "clean".into())])
}

/// The reports as they are after they were written to files and read again.
fn read(reports: &[Report]) -> Vec<Report> {
    let loaded = beam_lift();
    reports.iter().map(|report| Report::read(&report.text(&loaded), &loaded).expect("a report")).collect()
}

#[test]
fn the_reports_of_all_machines_give_one_summary() {
    let loaded = beam_lift();
    let reports = read(&[machine(0, 5), machine(1, 5), machine(2, 4)]);
    let (summary, trouble) = join(&loaded, &reports);
    let lift = &summary.rendezvous[0];
    assert_eq!((lift.rounds.released, lift.rounds.unknown, lift.false_releases), (4, 1, Some(0)));
    assert_eq!((summary.ports[0].sent, summary.nodes.len(), summary.seconds), (14, 3, 5.0));
    assert!(trouble.is_empty());
    // No machine can judge a check about tasks on several machines.
    let apart = summary.incomplete.iter().filter(|line| line.contains("share no clock")).count();
    assert_eq!(apart, summary.incomplete.len());
}

#[test]
fn a_machine_without_a_report_leaves_the_summary_incomplete() {
    let loaded = beam_lift();
    let (summary, trouble) = join(&loaded, &read(&[machine(0, 5), machine(2, 5)]));
    assert_eq!(summary.incomplete, ["node nr has no report"]);
    assert_eq!(Verdict::of(&summary, &trouble), Verdict::Incomplete);
    let lift = &summary.rendezvous[0];
    assert_eq!((lift.rounds.released, lift.rounds.unknown, lift.false_releases), (0, 5, None));
}

#[test]
fn the_problems_of_any_machine_are_those_of_the_cell() {
    let loaded = beam_lift();
    let what = "task `armR` aborts: \"no answer\"".to_owned();
    let bad = Report { trouble: vec![Trouble { at_fault: false, what }], ..machine(1, 5) };
    let (summary, trouble) = join(&loaded, &read(&[machine(0, 5), bad, machine(2, 5)]));
    assert_eq!(trouble.len(), 1);
    assert_eq!(Verdict::of(&summary, &trouble), Verdict::Finding);
}

#[test]
fn the_starts_of_one_node_add_up() {
    let loaded = beam_lift();
    let (summary, _) = join(&loaded, &read(&[machine(0, 5), machine(0, 3), machine(1, 5), machine(2, 5)]));
    assert_eq!((summary.nodes[0].incarnations, summary.nodes.len()), (2, 3));
    assert_eq!(summary.ports[0].sent, 18);
}

#[test]
fn what_is_no_report_of_this_cell_is_refused_by_name() {
    let loaded = beam_lift();
    let text = machine(0, 5).text(&loaded);
    let refused = |text: &str| Report::read(text, &loaded).expect_err("refused").to_string();
    assert!(refused("{}").contains("no report of a run"));
    assert!(refused("task armL on nl").contains("no report of a run"));
    assert!(refused(&text[..text.len() / 2]).contains("copy it again"));
    assert!(refused(&text.replace("\"sent\":5", "\"sent\":2000000000000")).contains("a number is too large"));
    let later = text.replace("\"version\":1", "\"version\":2");
    assert!(refused(&later).contains("version 2") && refused(&later).contains("reads version 1"));
    let digest = format!("{:08x}", loaded.table.digest());
    assert!(
        refused(&text.replace(&digest, "00000001"))
            .contains("its declarations differ (digest 00000001 there")
    );
    let mut strange = machine(0, 5);
    let link = serde_json::json!({
        "peer": 9, "delay": { "count": 0, "late": 0, "p50_us": 0, "p99_us": 0, "max_us": 0 },
        "recent": { "count": 0, "late": 0, "p50_us": 0, "p99_us": 0, "max_us": 0 }, "recent_us": 0, "unmeasured": 0,
        "integrity": { "failures": 0, "is_faulty": false, "faults": 0, "unmatched": 0 }, "has_stopped": false
    });
    let link: LinkReport = serde_json::from_value(link).expect("a link");
    strange.nodes[0].incarnations[0].links.push(link);
    assert!(refused(&strange.text(&loaded)).contains("the cell has no node 9"));
}
