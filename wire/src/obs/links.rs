//! What a node knows of its links beyond counters of packets: how long datagrams took, and how many were damaged (1.4).

use imrs_protocol::{NodeId, Ticks};
use serde::{Deserialize, Serialize};

/// The health of a node's links. The frame is sent with the [`Vitals`](super::Vitals), if the node has links that are measured.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkReports {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The links, ascending by neighbour.
    pub links: Vec<LinkReport>,
}

/// One direction of a link: what comes from one neighbour. All counts are since the start of the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkReport {
    /// The neighbour that sends.
    pub peer: NodeId,
    /// How long the measured datagrams took since the start of the node.
    pub delay: Delays,
    /// How long those of the last [`recent_us`](Self::recent_us) took.
    pub recent: Delays,
    /// The length of the recent time, in microseconds.
    pub recent_us: u64,
    /// How many datagrams were not measured, because the last exchange with the neighbour was too long ago to bound their delay.
    pub unmeasured: u64,
    /// What the link damaged.
    pub integrity: Integrity,
    /// Whether the neighbour has said that it stopped in order, and nothing came from it since.
    pub has_stopped: bool,
}

/// How long datagrams took from the sender's reading of its clock until the receiver had them, its wait in the receiver's
/// kernel included. No clocks are synchronized, so each time is an *upper bound*: the round trip of the best recent exchange
/// without the stay at the neighbour, and by how much this datagram was later than the one that completed that exchange.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delays {
    /// How many datagrams were measured.
    pub count: u64,
    /// How many of them certainly took longer than the link's declared bound: they were later than the fastest recent datagram
    /// by more than that.
    pub late: u64,
    /// Half of the bounds are at most this, in microseconds.
    pub p50_us: u64,
    /// 99 of 100 bounds are at most this, in microseconds.
    pub p99_us: u64,
    /// The greatest bound, in microseconds.
    pub max_us: u64,
}

/// Damage to what one neighbour sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Integrity {
    /// How many datagrams from the neighbour's address failed their checksum or their tag, or are no datagrams of this program.
    pub failures: u64,
    /// Whether the link counts as faulty at present: in one window so many datagrams were damaged, *and* as many of the
    /// neighbour's datagrams are missing.
    pub is_faulty: bool,
    /// How often it began to count as faulty.
    pub faults: u64,
    /// In how many windows so many bad datagrams came while the neighbour's own were not missing: another program sent them, it seems,
    /// under the neighbour's address.
    pub unmatched: u64,
}

/// A [`LinkReport`] in the answers that `imrs run` and `imrs monitor --once` print as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct LinkSummary {
    /// The neighbour that sends.
    pub from: String,
    /// The declared bound of the link, in microseconds.
    pub bound_us: u64,
    /// How long the measured datagrams took. Each time is an upper bound, which round trips prove.
    pub delay: Delays,
    /// The same, of the recent time.
    pub recent: Delays,
    /// The length of the recent time, in microseconds.
    pub recent_us: u64,
    /// How many datagrams were not measured, because no exchange was recent enough.
    pub unmeasured: u64,
    /// How delays compare with the bound: those of the whole run in its summary, the recent ones in the monitor.
    pub margin: Margin,
    /// What was damaged.
    pub integrity: Integrity,
    /// Whether the neighbour has said that it stopped in order.
    pub has_stopped: bool,
}

impl LinkReport {
    /// The report, with the name of the neighbour and the declared bound of the link.
    #[must_use]
    pub fn summary(&self, from: &str, bound_us: u64, margin: Margin) -> LinkSummary {
        LinkSummary {
            from: from.to_owned(),
            bound_us,
            delay: self.delay,
            recent: self.recent,
            recent_us: self.recent_us,
            unmeasured: self.unmeasured,
            margin,
            integrity: self.integrity,
            has_stopped: self.has_stopped,
        }
    }
}

/// Which part of a link's declared bound its datagrams take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Margin {
    /// Too few datagrams were measured, or they leave enough of the bound.
    Enough,
    /// The 99th percentile is more than [`Delays::NEAR_PERCENT`] of the bound. It is an upper bound, so the datagrams may have
    /// been faster.
    Near,
    /// More than one in a hundred datagrams certainly took longer than the bound.
    Exceeded,
}

impl Delays {
    /// Above how many percent of the declared bound the 99th percentile comes near it.
    pub const NEAR_PERCENT: u64 = 80;
    /// Fewer datagrams than this are no basis for a warning: a single one is late on any busy machine.
    pub const A_RULE: u64 = 20;

    /// Compares the delays with the declared bound of their link.
    #[must_use]
    pub const fn margin(&self, bound: Ticks) -> Margin {
        if self.count < Self::A_RULE {
            Margin::Enough
        } else if self.late > self.count / 100 {
            Margin::Exceeded
        } else if self.p99_us.saturating_mul(100) > bound.0.saturating_mul(Self::NEAR_PERCENT) {
            Margin::Near
        } else {
            Margin::Enough
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_near_from_four_fifths_on_and_exceeded_by_more_than_one_in_a_hundred() {
        let delays = |count, late, p99_us| Delays { count, late, p99_us, ..Delays::default() };
        let margin = |delays: Delays| delays.margin(Ticks(5_000));
        assert_eq!(margin(delays(100, 0, 4_000)), Margin::Enough);
        assert_eq!(margin(delays(100, 0, 4_001)), Margin::Near);
        assert_eq!(margin(delays(19, 19, 90_000)), Margin::Enough, "too few");
        assert_eq!(margin(delays(100, 1, 9_000)), Margin::Near, "one in a hundred");
        assert_eq!(margin(delays(100, 2, 9_000)), Margin::Exceeded);
        assert_eq!(margin(delays(u64::MAX, u64::MAX, u64::MAX)), Margin::Exceeded);
    }
}
