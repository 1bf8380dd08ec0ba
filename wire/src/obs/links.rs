//! What a node knows of its links beyond counters of packets: how long datagrams took, and how many were damaged (1.4).

use imrs_protocol::{NodeId, Ticks};
use serde::{Deserialize, Serialize};

/// The health of a node's links. If the node has links that it measures, it sends this frame with the
/// [`Vitals`](super::Vitals).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkReports {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The links, ascending by neighbour.
    pub links: Vec<LinkReport>,
}

/// One direction of a link: the datagrams from one neighbour. All counts are since the start of the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkReport {
    /// The neighbour that sends.
    pub peer: NodeId,
    /// How long the measured datagrams took since the start of the node.
    pub delay: Delays,
    /// How long the measured datagrams of the last [`recent_us`](Self::recent_us) microseconds took.
    pub recent: Delays,
    /// The length of the time for [`recent`](Self::recent), in microseconds.
    pub recent_us: u64,
    /// How many datagrams were not measured, because the last exchange of datagrams with the neighbour was too long ago
    /// to bound their delay.
    pub unmeasured: u64,
    /// The damage to the datagrams from the neighbour.
    pub integrity: Integrity,
    /// Whether the neighbour has said that it stopped in order, and has sent nothing since.
    pub has_stopped: bool,
}

/// How long datagrams took: from the instant at which the sender read its clock until the receiver took them, including
/// their wait in the receiver's kernel. No clocks are synchronized, so each time is only an *upper bound*. It is the
/// round trip of the best recent exchange, without the time at the neighbour, plus the difference by which this
/// datagram was later than the one that completed that exchange.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delays {
    /// How many datagrams were measured.
    pub count: u64,
    /// How many datagrams certainly took longer than the link's declared bound: compared with the fastest recent
    /// datagram, they were later by more than the bound.
    pub late: u64,
    /// The median of the times, in microseconds. As each time is an upper bound, so is the median.
    pub p50_us: u64,
    /// The 99th percentile of the times, in microseconds: an upper bound, too.
    pub p99_us: u64,
    /// The greatest of the times, in microseconds: an upper bound, too.
    pub max_us: u64,
}

/// The damage to datagrams from one neighbour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Integrity {
    /// How many datagrams from the neighbour's address failed their checksum or their tag, or were no datagrams of this
    /// program.
    pub failures: u64,
    /// Whether the link counts as faulty now. A link is faulty if, within one window of time, more than a fixed number
    /// of datagrams were damaged *and* more than that number of the neighbour's datagrams are missing.
    pub is_faulty: bool,
    /// How often the link has begun to count as faulty.
    pub faults: u64,
    /// The number of windows in which too many datagrams were damaged, but fewer of the neighbour's datagrams were missing.
    /// Then another program probably sent the damaged ones, under the neighbour's address.
    pub unmatched: u64,
}

/// A [`LinkReport`] in the answers that `imrs run` and `imrs monitor --once` print as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct LinkSummary {
    /// The neighbour that sends.
    pub from: String,
    /// The declared bound of the link, in microseconds.
    pub bound_us: u64,
    /// How long the measured datagrams took. Each time is an upper bound, which follows from round trips.
    pub delay: Delays,
    /// How long the measured datagrams of the recent time took.
    pub recent: Delays,
    /// The length of the recent time, in microseconds.
    pub recent_us: u64,
    /// How many datagrams were not measured, because the last exchange with the neighbour was too long ago.
    pub unmeasured: u64,
    /// How the delays compare with the declared bound. In the summary of a run these are all delays, in the monitor the
    /// recent ones.
    pub margin: Margin,
    /// The damage to the datagrams from the neighbour.
    pub integrity: Integrity,
    /// Whether the neighbour has said that it stopped in order.
    pub has_stopped: bool,
}

impl LinkReport {
    /// This report with the name of the neighbour and the declared bound of the link added.
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

/// How the delays of a link's datagrams compare with the link's declared bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Margin {
    /// The delays leave enough of the bound, or too few datagrams were measured.
    Enough,
    /// The 99th percentile is more than [`Delays::NEAR_PERCENT`] of the bound. The percentile is an upper bound of the
    /// delay, so the datagrams may have been faster.
    Near,
    /// More than one in a hundred datagrams certainly took longer than the bound.
    Exceeded,
}

impl Delays {
    /// The percentage of the declared bound above which the 99th percentile counts as near the bound.
    pub const NEAR_PERCENT: u64 = 80;
    /// The least number of measured datagrams for a warning. On any busy machine single datagrams are late, so fewer
    /// prove nothing.
    pub const A_RULE: u64 = 20;

    /// The delays beside the declared bound of their link, for every text and screen that shows them. All figures are
    /// milliseconds, rounded up to about three digits. With fewer datagrams than [`Self::A_RULE`] there are no figures.
    ///
    /// ```
    /// use imrs_wire::obs::Delays;
    ///
    /// let delays = Delays { count: 300, late: 0, p50_us: 90, p99_us: 4_210, max_us: 12_345 };
    /// assert_eq!(delays.beside(5_000), "p50 0.09, p99 4.21, max 12.4 of 5 ms");
    /// assert_eq!(Delays { count: 7, ..delays }.beside(5_000), "too few to judge (7)");
    /// ```
    #[must_use]
    pub fn beside(&self, bound_us: u64) -> String {
        if self.count < Self::A_RULE {
            return format!("too few to judge ({})", self.count);
        }
        let [p50, p99, max] = [self.p50_us, self.p99_us, self.max_us].map(milliseconds);
        format!("p50 {p50}, p99 {p99}, max {max} of {} ms", bound_us as f64 / 1_000.0)
    }

    /// The 99th percentile beside the bound, as in [`Self::beside`], where a row has no room for more: `4.21/5 ms`.
    #[must_use]
    pub fn briefly_beside(&self, bound_us: u64) -> Option<String> {
        let p99 = (self.count >= Self::A_RULE).then(|| milliseconds(self.p99_us))?;
        Some(format!("{p99}/{} ms", bound_us as f64 / 1_000.0))
    }

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

/// Microseconds as milliseconds with about three digits, rounded up, because delays are upper bounds.
fn milliseconds(us: u64) -> String {
    match us {
        0..10_000 => format!("{:.2}", us.div_ceil(10) as f64 / 100.0),
        10_000..100_000 => format!("{:.1}", us.div_ceil(100) as f64 / 10.0),
        _ => us.div_ceil(1_000).to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_stand_beside_their_bound_in_one_unit() {
        let delays = |count, p50_us| Delays { count, late: 0, p50_us, p99_us: 99_901, max_us: 1_234_001 };
        assert_eq!(delays(20, 9_990).beside(250), "p50 9.99, p99 100.0, max 1235 of 0.25 ms");
        assert_eq!(delays(20, 1).beside(2_000_000), "p50 0.01, p99 100.0, max 1235 of 2000 ms");
        assert_eq!(delays(20, 0).briefly_beside(5_000).as_deref(), Some("100.0/5 ms"));
        assert_eq!(delays(19, 0).beside(5_000), "too few to judge (19)");
        assert_eq!(delays(19, 0).briefly_beside(5_000), None);
    }

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
