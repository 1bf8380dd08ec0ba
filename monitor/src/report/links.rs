//! The links of a node in the JSON format of `imrs monitor --once`.

use crate::clock::Moment;
use crate::store::NodeIncarnation;
use imrs_wire::obs::{Delays, Integrity, Margin};
use serde::Serialize;

/// One direction of a link, as the node measures it.
#[derive(Serialize)]
pub(super) struct Link<'a> {
    /// The neighbour that sends.
    from: &'a str,
    bound_us: u64,
    /// How long the measured datagrams took since the node's start. Each time is an upper bound.
    delay: Delays,
    /// The same, of the last `recent_us`.
    recent: Delays,
    recent_us: u64,
    unmeasured: u64,
    /// How the recent delays compare with the bound: `enough`, `near` or `exceeded`.
    margin: &'static str,
    integrity: Integrity,
    /// Whether the neighbour has said that it stopped in order.
    has_stopped: bool,
}

/// The links to a node; empty if it does not measure them.
pub(super) fn links(incarnation: &NodeIncarnation, now: Moment) -> Vec<Link<'_>> {
    let link = |measured: crate::store::Measured<'_>| Link {
        from: incarnation.names.nodes.get(measured.report.peer.index()).map_or("?", |node| node.raw()),
        bound_us: measured.bound_us,
        delay: measured.report.delay,
        recent: measured.report.recent,
        recent_us: measured.report.recent_us,
        unmeasured: measured.report.unmeasured,
        margin: match measured.margin() {
            Margin::Enough => "enough",
            Margin::Near => "near",
            Margin::Exceeded => "exceeded",
        },
        integrity: measured.report.integrity,
        has_stopped: measured.report.has_stopped,
    };
    incarnation.measured(now).map(link).collect()
}
