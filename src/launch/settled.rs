//! What came of the rounds of a waitfor that are no longer kept one by one.

use super::rounds::Rounds;
use super::spread::Spreading;
use std::collections::BTreeMap;

/// So many gaps between settled rounds are remembered.
const GAPS: usize = 1_024;
/// So many rounds with false releases are kept apart.
const DOUBTFUL: usize = 4_096;

/// What came of older rounds. Sets of members are bits by position.
#[derive(Clone, Debug, Default)]
pub struct Settled {
    /// Without the spread, and without the false releases of the `doubtful` rounds.
    pub sum: Rounds,
    pub skews: Spreading,
    /// Which: by the first of several without a gap, the last.
    pub spans: BTreeMap<i64, i64>,
    /// The last one that released somebody.
    pub released: Option<i64>,
    /// Rounds that released somebody before another member had announced it, as far as was told: who had not, and who was
    /// released. It may come out later that some of that member's announcements were not told.
    doubtful: BTreeMap<i64, (u64, u64)>,
}

impl Settled {
    /// Whether this round is one of them.
    pub fn has(&self, round: i64) -> bool {
        self.spans.range(..=round).next_back().is_some_and(|(_, &last)| round <= last)
    }

    /// This round is one, too.
    pub fn add(&mut self, round: i64) {
        let (mut first, mut last) = (round, round);
        if let Some((&before, &end)) = self.spans.range(..round).next_back()
            && end + 1 == round
        {
            first = before;
        }
        if let Some(end) = self.spans.remove(&(round + 1)) {
            last = end;
        }
        self.spans.insert(first, last);
        // Nobody speaks of rounds that are so old.
        if self.spans.len() > GAPS
            && let Some((first, _)) = self.spans.pop_first()
            && let Some((_, last)) = self.spans.pop_first()
        {
            self.spans.insert(first, last);
        }
    }

    /// In this settled round some were released without an announcement of the `absent`.
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

    /// This member's announcement of a settled round was told late.
    pub fn announced(&mut self, round: i64, member: u64) {
        if let Some((absent, _)) = self.doubtful.get_mut(&round) {
            *absent &= !member;
        }
    }

    /// False releases, where some announcements of the `untold` members are missing.
    pub fn false_releases(&self, untold: u64) -> u64 {
        let kept = self.doubtful.values().map(|(absent, released)| falsely(absent & !untold, *released));
        self.sum.false_releases + kept.sum::<u64>()
    }
}

/// How many of the released members were released before another one had arrived.
pub fn falsely(absent: u64, released: u64) -> u64 {
    match absent.count_ones() {
        0 => 0,
        1 => (released & !absent).count_ones().into(),
        _ => released.count_ones().into(),
    }
}
