//! The sums over old rounds of a waitfor, which are no longer kept one by one. Such rounds are called settled.

use super::rounds::Rounds;
use super::spans::Spans;
use super::spread::Spreading;
use std::collections::BTreeMap;

/// The greatest number of gaps between settled rounds that are kept.
const GAPS: usize = 1_024;
/// The greatest number of rounds with false releases that are kept one by one.
const DOUBTFUL: usize = 4_096;

/// The outcomes of old rounds. Sets of members are bit masks by position.
#[derive(Clone, Debug, Default)]
pub struct Settled {
    /// The sums over the settled rounds, without the start skew, and without the false releases of the rounds in `doubtful`.
    pub sum: Rounds,
    pub skews: Spreading,
    /// The settled rounds.
    pub spans: Spans,
    /// The newest settled round that released a member.
    pub released: Option<i64>,
    /// Settled rounds that look like false releases. For each of them: the members that had not announced the round, and the
    /// members that were released. A later report may show that a member's announcement did not reach the launcher.
    doubtful: BTreeMap<i64, (u64, u64)>,
}

impl Settled {
    /// Whether this round was settled.
    pub fn has(&self, round: i64) -> bool {
        self.spans.has(round)
    }

    /// Marks this round as settled.
    pub fn add(&mut self, round: i64) {
        self.spans.add(round);
        // No later event can name a round that is this old, so the oldest gap between settled rounds can be
        // closed.
        if self.spans.pieces() > GAPS {
            self.spans.close_oldest_gap();
        }
    }

    /// Notes that this settled round released members although the members in `absent` had not announced it.
    pub fn doubt(&mut self, round: i64, absent: u64, released: u64) {
        if falsely(absent, released) == 0 {
            return;
        }
        self.doubtful.insert(round, (absent, released));
        if self.doubtful.len() > DOUBTFUL
            && let Some((_, (absent, released))) = self.doubtful.pop_first()
        {
            self.sum.false_releases += falsely(absent, released);
        }
    }

    /// Notes a late report that this member had announced a settled round.
    pub fn announced(&mut self, round: i64, member: u64) {
        if let Some((absent, _)) = self.doubtful.get_mut(&round) {
            *absent &= !member;
        }
    }

    /// The number of false releases, if the members in `untold` may have made announcements that they could not report.
    pub fn false_releases(&self, untold: u64) -> u64 {
        let kept = self.doubtful.values().map(|(absent, released)| falsely(absent & !untold, *released));
        self.sum.false_releases + kept.sum::<u64>()
    }
}

/// How many of the released members were released while another member was absent. If only one member is absent, its
/// own release does not count.
pub fn falsely(absent: u64, released: u64) -> u64 {
    match absent.count_ones() {
        0 => 0,
        1 => (released & !absent).count_ones().into(),
        _ => released.count_ones().into(),
    }
}
