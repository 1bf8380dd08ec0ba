//! The links in the summary of a run: delays against the declared bounds, damage, and datagrams that no node of the cell sent.

use crate::words::{count, grouped, span};
use imrs_protocol::{CellTable, NodeId, Ticks};
use imrs_runtime::link::udp::{FAILURES, WINDOW};
use imrs_wire::obs::{Integrity, LinkReport, LinkSummary, Margin};
use serde::Serialize;
use std::collections::BTreeMap;

/// The datagrams that a node dropped, and that no node of the cell sent in this form.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SecuritySummary {
    /// The number of datagrams for each reason of the drop.
    pub events: BTreeMap<String, u64>,
    /// How many windows of ten seconds had more than eight such datagrams.
    pub alarms: u64,
}

/// The reasons for drops of datagrams that no node of the cell sent in this form: forged, repeated, with other keys, or from
/// strangers. Datagrams of earlier sessions are missing here, because a restart leaves some.
const SECURITY: [&str; 8] =
    ["forged", "replayed", "other_keys", "not_imrs", "unknown_node", "too_short", "length", "checksum"];

/// Converts the report of the node `to` about the link from a neighbour for the summary of a run.
pub fn link_summary(table: &CellTable, to: NodeId, report: &LinkReport) -> LinkSummary {
    let bound = table.link_bound(to, report.peer).unwrap_or(Ticks::ZERO);
    report.summary(&table.cell().nodes[report.peer.index()].name, bound.0, report.delay.margin(bound))
}

/// The warnings about a link to the node `to`, in words for people.
#[must_use]
pub fn link_warnings(link: &LinkSummary, to: &str) -> Vec<String> {
    let LinkSummary { from, delay, integrity, .. } = link;
    let (bound, p99) = (span(link.bound_us), span(delay.p99_us));
    let mut words = Vec::new();
    match link.margin {
        Margin::Enough => {}
        Margin::Near => words.push(format!(
            "link {from} -> {to}: 99 of 100 datagrams took at most {p99}, as far as this node can tell, and its declared bound is {bound}"
        )),
        Margin::Exceeded => words.push(format!(
            "link {from} -> {to}: {} of {} took longer than its declared {bound}, which the checks rely on",
            delay.late,
            count(delay.count, "datagram"),
        )),
    }
    if integrity.faults > 0 {
        words.push(fault_words(from, to, integrity));
    }
    words
}

/// A sentence that says that a link counts as faulty.
pub fn fault_words(from: &str, to: &str, integrity: &Integrity) -> String {
    format!(
        "link {from} -> {to} is faulty: {} came in, and what {from} sent is missing",
        count(integrity.failures, "damaged datagram")
    )
}

/// A sentence that says that a node dropped datagrams that no node of the cell sent.
pub fn security_words(node: &str, security: &SecuritySummary) -> String {
    let events = security.events.iter().map(|(name, n)| format!("{name} {}", grouped(*n)));
    format!(
        "node {node} dropped {} that no node of the cell sent so: {}",
        count(security.total(), "datagram"),
        events.collect::<Vec<_>>().join(", ")
    )
}

/// Adds the reports of a node's next incarnation about its links. Each percentile of the sum is the greater one of both
/// incarnations.
pub fn join(sum: &mut Vec<LinkReport>, more: &[LinkReport]) {
    for report in more {
        match sum.iter_mut().find(|known| known.peer == report.peer) {
            Some(known) => {
                let (delay, integrity) = (known.delay, known.integrity);
                let unmeasured = known.unmeasured + report.unmeasured;
                *known = LinkReport { unmeasured, ..report.clone() };
                known.delay.count += delay.count;
                known.delay.late += delay.late;
                known.delay.p50_us = known.delay.p50_us.max(delay.p50_us);
                known.delay.p99_us = known.delay.p99_us.max(delay.p99_us);
                known.delay.max_us = known.delay.max_us.max(delay.max_us);
                known.integrity.failures += integrity.failures;
                known.integrity.faults += integrity.faults;
                known.integrity.unmatched += integrity.unmatched;
            }
            None => sum.push(report.clone()),
        }
    }
}

impl SecuritySummary {
    /// Counts the datagrams that a node's link dropped, and that no node of the cell sent.
    pub fn new(link_discards: &BTreeMap<String, u64>, alarms: u64) -> Self {
        let is_one = |(name, _): &(&String, &u64)| SECURITY.contains(&name.as_str());
        let events = link_discards.iter().filter(is_one).map(|(name, n)| (name.clone(), *n)).collect();
        Self { events, alarms }
    }

    /// The alarms, in words for people; `None` without any.
    #[must_use]
    pub fn warning(&self, node: &str) -> Option<String> {
        (self.alarms > 0).then(|| security_words(node, self))
    }

    /// The number of dropped datagrams, for all reasons together.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.events.values().sum()
    }
}

/// Finds the windows in which a node dropped more than [`FAILURES`] datagrams that no node of the cell sent.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alarm {
    begun: u64,
    before: u64,
    last: u64,
    /// How often the alarm was raised.
    pub raised: u64,
}

impl Alarm {
    /// Takes the counters of a node at an instant. Returns whether they raise the alarm.
    pub fn take(&mut self, at: u64, link_discards: &BTreeMap<String, u64>) -> bool {
        let now = SecuritySummary::new(link_discards, 0).total();
        // The counters of a new incarnation begin at zero.
        self.before = if now < self.last { 0 } else { self.before };
        if at.saturating_sub(self.begun) >= WINDOW {
            (self.begun, self.before) = (at, self.last.min(now));
        }
        self.last = now;
        let is_raised = now.saturating_sub(self.before) > FAILURES;
        if is_raised {
            // Each window raises at most one alarm.
            self.before = u64::MAX;
            self.raised += 1;
        }
        is_raised
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::tests::beam_lift;
    use imrs_wire::obs::Delays;

    fn report(count: u64, late: u64, p99_us: u64) -> LinkReport {
        let delay = Delays { count, late, p50_us: 100, p99_us, max_us: p99_us };
        LinkReport {
            peer: NodeId(1),
            delay,
            recent: delay,
            recent_us: 7_000_000,
            unmeasured: 4,
            integrity: Integrity::default(),
            has_stopped: false,
        }
    }

    #[test]
    fn a_link_is_compared_with_its_declared_bound() {
        let loaded = beam_lift();
        let bound = loaded.table.link_bound(NodeId(0), NodeId(1)).unwrap().0;
        let told = |report: &LinkReport| {
            let summary = link_summary(&loaded.table, NodeId(0), report);
            (serde_json::json!(summary.margin), link_warnings(&summary, "nl").join("\n"))
        };
        assert_eq!(told(&report(500, 5, bound / 2)), ("enough".into(), String::new()));
        let (margin, words) = told(&report(500, 5, bound));
        assert!(
            margin == "near"
                && words.contains("link nr -> nl")
                && words.contains("as far as this node can tell"),
            "{words}"
        );
        let (margin, words) = told(&report(500, 6, bound));
        assert!(margin == "exceeded" && words.contains("6 of 500 datagrams"), "{words}");
        let faulty = Integrity { failures: 12, is_faulty: false, faults: 1, unmatched: 0 };
        let (_, words) = told(&LinkReport { integrity: faulty, ..report(0, 0, 0) });
        assert_eq!(
            words,
            "link nr -> nl is faulty: 12 damaged datagrams came in, and what nr sent is missing"
        );
    }

    #[test]
    fn incarnations_of_a_node_add_up() {
        let mut sum = Vec::new();
        let faults = Integrity { failures: 9, is_faulty: true, faults: 1, unmatched: 0 };
        join(&mut sum, &[LinkReport { integrity: faults, ..report(10, 1, 900) }]);
        join(&mut sum, &[report(30, 0, 400), LinkReport { peer: NodeId(2), ..report(1, 0, 7) }]);
        assert_eq!(sum[0].delay, Delays { count: 40, late: 1, p50_us: 100, p99_us: 900, max_us: 900 });
        assert_eq!(sum[0].integrity, Integrity { is_faulty: false, ..faults });
        assert_eq!((sum[0].unmeasured, sum[1].delay.count), (8, 1));
    }

    #[test]
    fn an_alarm_is_raised_once_in_a_window_and_not_by_what_a_restart_leaves() {
        let drops = |name: &str, n| BTreeMap::from([(name.to_owned(), n)]);
        let mut alarm = Alarm::default();
        assert!(!alarm.take(1, &drops("forged", FAILURES)));
        assert!(alarm.take(2, &drops("forged", FAILURES + 1)));
        assert!(!alarm.take(3, &drops("forged", 900)), "in the same window");
        assert!(!alarm.take(WINDOW + 3, &drops("forged", 900)), "no more came");
        assert!(alarm.take(WINDOW + 4, &drops("forged", 909)));
        assert_eq!(alarm.raised, 2);
        let mut alarm = Alarm::default();
        assert!(!alarm.take(1, &drops("stale_session", 1_000)));
        assert!(!alarm.take(2, &drops("forged", 7)) && !alarm.take(3, &drops("forged", 5)), "a restart");
        // A few such datagrams in every window raise no alarm.
        let mut alarm = Alarm::default();
        assert!((1..100).all(|n| !alarm.take(n * WINDOW, &drops("replayed", n * FAILURES))));
    }
}
