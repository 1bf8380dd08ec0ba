//! What nodes report of their links: how long datagrams took, and whether links count as faulty.

use super::journal::{Entry, Severity, What};
use super::{Condition, NodeIncarnation, Received, Store};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{NodeId, Ticks};
use imrs_wire::obs::{LinkReport, LinkReports, Margin};
use std::time::Duration;

/// For how long a node's report on its links is used.
const LATELY: Duration = Duration::from_secs(3);

/// One direction of a link, with its declared bound.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// What the receiving node reports.
    pub report: &'a LinkReport,
    /// The declared bound of the link, in microseconds.
    pub bound_us: u64,
}

impl Measured<'_> {
    /// How the recent delays compare with the bound.
    #[must_use]
    pub const fn margin(&self) -> Margin {
        self.report.recent.margin(Ticks(self.bound_us))
    }
}

impl NodeIncarnation {
    /// The links to this node, if it reported on them within the last seconds.
    pub fn measured(&self, now: Moment) -> impl Iterator<Item = Measured<'_>> {
        let told = self.links.iter().filter(move |told| now.saturating_sub(told.at) <= LATELY);
        told.flat_map(|told| &told.what.links).filter_map(|report| {
            let ends = [(self.node_id, report.peer), (report.peer, self.node_id)];
            let link = self.names.links.iter().find(|link| ends.contains(&(link.a, link.b)))?;
            Some(Measured { report, bound_us: link.delay.0.saturating_mul(self.tick_us) })
        })
    }

    /// How often the link from this neighbour has begun to count as faulty.
    fn faults_of(&self, peer: NodeId) -> u64 {
        let links = self.links.as_ref().map_or(&[][..], |told| &told.what.links);
        links.iter().find(|link| link.peer == peer).map_or(0, |link| link.integrity.faults)
    }
}

impl Store {
    /// A neighbour says that this node has stopped in order. So it is not dead, though this monitor got no goodbye.
    fn stopped(&mut self, cell: &Name, node: NodeId) {
        let of_node = |l: &&mut NodeIncarnation| l.names.cell == *cell && l.node_id == node;
        if let Some(last) = self.incarnations.iter_mut().filter(of_node).max_by_key(|l| l.id)
            && let Condition::Dead { since, .. } = last.condition
        {
            last.condition = Condition::Stopped { since };
        }
    }

    /// Whether any neighbour reports that this node has stopped in order.
    #[must_use]
    pub fn is_said_to_have_stopped(&self, cell: &Name, node: NodeId) -> bool {
        let links = self.incarnations_of(cell).filter_map(|incarnation| incarnation.links.as_ref());
        links.flat_map(|told| &told.what.links).any(|link| link.peer == node && link.has_stopped)
    }

    /// Stores a node's report on its links. The journal notes each link that began to count as faulty.
    pub(super) fn links(&mut self, at: Moment, index: usize, what: LinkReports) {
        let incarnation = &self.incarnations[index];
        let faulty =
            what.links.iter().filter(|link| link.integrity.faults > incarnation.faults_of(link.peer));
        for link in faulty {
            let from = incarnation.names.node(link.peer);
            let detail = format!("from {from}: {} damaged datagrams so far", link.integrity.failures);
            let (level, kind, object) = (Severity::Warn, "link faulty", String::new());
            let what = What::Noticed { level, kind, object, detail };
            self.journal.add(Entry::new(at, incarnation, what, 1));
        }
        let cell = incarnation.names.cell.clone();
        let stopped = what.links.iter().filter(|link| link.has_stopped);
        stopped.for_each(|link| self.stopped(&cell, link.peer));
        self.incarnations[index].links = Some(Received { at, what });
    }
}
