//! The links of a node in the JSON format of `imrs monitor --once`.

use crate::clock::Moment;
use crate::store::NodeIncarnation;
use imrs_wire::obs::LinkSummary;

/// The links to a node; empty if it does not measure them.
pub(super) fn links(incarnation: &NodeIncarnation, now: Moment) -> Vec<LinkSummary> {
    let link = |measured: crate::store::Measured<'_>| {
        let from = incarnation.names.nodes.get(measured.report.peer.index()).map_or("?", |node| node.raw());
        measured.report.summary(from, measured.bound_us, measured.margin())
    };
    incarnation.measured(now).map(link).collect()
}
