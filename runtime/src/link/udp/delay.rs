//! Bounds how long a datagram took on its link, without any common clock (D20).
//!
//! Let `offset` be this node's clock minus the sender's. A datagram that left at `tx` (sender's clock) and that this
//! node received at `recv` (this node's clock) took `(recv - tx) - offset`. The offset is unknown, but every echo
//! bounds it from below: at the instant `tx` of the sender's clock, this node's clock had already reached `echo`, so
//! `offset >= echo - tx`. With the best such bound, a datagram took at most `(recv - tx) - bound`. That is the round
//! trip of the best echo, plus the additional delay of this datagram compared with the one that carried the echo. If
//! the sender was stopped between reading its clock and sending, that time is included.
//!
//! Two clocks may drift apart by [`DRIFT_PPM`], so a bound weakens with age. A newer bound replaces an older one once
//! the older one is not stronger any more.
//!
//! Before the first echo there is only the declared bound of the link: this module assumes that the fastest recent
//! datagram has kept that bound.

use imrs_protocol::Ticks;

/// How fast two monotonic clocks may drift apart, in parts per million: each may deviate by 200 from true time.
pub(super) const DRIFT_PPM: u64 = 400;
/// The rounding of four clock readings adds up to at most this many microseconds.
const ROUNDING: i64 = 4;

/// What this node knows about the delay of datagrams from one neighbour, in one incarnation of that neighbour. Clocks
/// are in microseconds, each from its own origin.
#[derive(Clone, Debug)]
pub(super) struct LinkDelay {
    declared: i64,
    /// The best lower bound of the clocks' offset that an echo gave.
    proven: Option<Sample>,
    /// The least `recv - tx` of the recent datagrams.
    fastest: Option<Sample>,
}

/// How long a datagram has taken on its hop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Hop {
    /// The datagram took no longer than this.
    pub(super) longest: Ticks,
    /// The datagram took at least this long, because it was later by this time than the fastest recent datagram.
    pub(super) shortest: Ticks,
    /// Whether an echo of this node's clock proves `longest`. Otherwise `longest` depends on the declared
    /// bound of the link.
    pub(super) is_proven: bool,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    value: i64,
    at: u64,
}

impl Sample {
    /// How far the two clocks may have drifted apart since this sample.
    fn drift(&self, now: u64) -> i64 {
        let age = now.saturating_sub(self.at);
        i64::try_from(age / (1_000_000 / DRIFT_PPM)).unwrap_or(i64::MAX)
    }
}

impl LinkDelay {
    /// The state in which only the link's declared bound is known.
    pub(super) fn new(declared: Ticks) -> Self {
        Self { declared: i64::try_from(declared.0).unwrap_or(i64::MAX), proven: None, fastest: None }
    }

    /// Bounds the time that a datagram has taken, its wait in this node's kernel included. The result is defined for all
    /// values, because a sender may write anything into its clocks.
    pub(super) fn arrived(&mut self, tx: u64, echo: Option<u64>, recv: u64) -> Hop {
        let apart = recv.wrapping_sub(tx).cast_signed();
        let mut proven = self.proven.map(|p| p.value.saturating_sub(p.drift(recv)));
        // A datagram cannot arrive before it was sent: a bound that implies this came from a wrong clock.
        if proven.is_some_and(|least| least > apart.saturating_add(ROUNDING)) {
            proven = None;
        }
        // An echo from the future of this node's clock does not count.
        if let Some(echo) = echo.filter(|&echo| echo <= recv) {
            let value = echo.wrapping_sub(tx).cast_signed();
            if proven.is_none_or(|least| value >= least) {
                self.proven = Some(Sample { value, at: recv });
                proven = Some(value);
            }
        }
        if proven.is_none() {
            self.proven = None;
        }
        // No datagram arrives before it was sent, so the offset is at most the least `recv - tx`, that of the fastest
        // datagram.
        let fastest = self.fastest.map(|f| f.value.saturating_add(f.drift(recv)));
        let most_offset = fastest.filter(|&fastest| fastest < apart).unwrap_or(apart);
        if most_offset == apart {
            self.fastest = Some(Sample { value: apart, at: recv });
        }
        let assumed = || {
            let fastest = self.fastest.map(|f| f.value.saturating_sub(f.drift(recv)));
            fastest.map(|fastest| fastest.saturating_sub(self.declared))
        };
        let least_offset = proven.or_else(assumed).unwrap_or(apart);
        let ticks = |time: i64| Ticks(u64::try_from(time).unwrap_or(0));
        Hop {
            longest: ticks(apart.saturating_sub(least_offset).saturating_add(ROUNDING)),
            shortest: ticks(apart.saturating_sub(most_offset).saturating_sub(ROUNDING)),
            is_proven: proven.is_some(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DECLARED: Ticks = Ticks(2_000);

    #[test]
    fn a_stopped_sender_yields_old_datagrams() {
        let mut d = LinkDelay::new(DECLARED);
        // In this test the offset of the clocks is 1,000,000; each way takes 60 us; an echo is held for 1 ms.
        assert_eq!(d.arrived(1_000, Some(1_000_940), 1_001_060).longest, Ticks(120 + 4));
        assert_eq!(d.arrived(3_000, None, 1_003_060).longest, Ticks(120 + 4));
        // Here 500 ms pass between the sender's reading of its clock and its `sendto`.
        assert_eq!(d.arrived(5_000, None, 1_505_060).longest, Ticks(500_120 + 4 + 201));
    }

    #[test]
    fn before_the_first_echo_the_fastest_datagram_is_taken_to_have_kept_the_bound() {
        let mut d = LinkDelay::new(DECLARED);
        assert_eq!(d.arrived(0, None, 7_000_050).longest, Ticks(2_004));
        assert_eq!(d.arrived(1_000, None, 7_301_050).longest, Ticks(2_004 + 300_000 + 120));
        assert_eq!(d.arrived(400_000, None, 7_400_030).longest, Ticks(2_004));
    }

    #[test]
    fn an_echo_from_the_future_is_none() {
        let mut d = LinkDelay::new(DECLARED);
        assert_eq!(d.arrived(0, Some(51), 50).longest, Ticks(2_004));
    }

    #[test]
    fn a_bound_that_a_later_datagram_contradicts_is_forgotten() {
        let mut d = LinkDelay::new(DECLARED);
        assert_eq!(d.arrived(1_000, Some(1_000_940), 1_001_060).longest, Ticks(120 + 4));
        // A datagram whose clock is mistaken claims an offset that is a second too large.
        d.arrived(0, Some(2_000_000), 2_000_060);
        // The next datagram shows that the claimed offset is wrong, and how long the datagram itself took.
        assert_eq!(d.arrived(2_000_000, Some(2_999_940), 3_000_060).longest, Ticks(120 + 4));
    }

    proptest! {
        /// Tests two clocks that drift, delays of any length, and echoes held for any time: `longest` is never less
        /// than the true time, and `shortest` never more.
        #[test]
        fn the_truth_lies_between_the_bounds(
            ppm in -190..190_i64, offset in 0..1_000_000_000_i64,
            trips in proptest::collection::vec((0..20_000_u64, 0..20_000_u64, 0..3_000_000_u64, any::<bool>()), 1..60),
        ) {
            // True time is this node's clock. The sender's clock runs `ppm` fast, and is `offset` behind.
            let theirs = |us: u64| {
                let us = i64::try_from(us).unwrap();
                u64::try_from(us + us * ppm / 1_000_000 + 2_000_000_000 - offset).unwrap()
            };
            let mut d = LinkDelay::new(DECLARED);
            let mut now = 1_000_000;
            // The first round trip has an echo, because without an echo `longest` depends on the declared bound.
            for (i, (out, back, held, echoed)) in trips.into_iter().enumerate() {
                let (sent, heard) = (now, now + out);
                let tx = theirs(heard + held);
                let echo = sent + (theirs(heard + held) - theirs(heard));
                // The time for which the echo is held is measured with a clock that may run fast.
                let echo = echo - held / (1_000_000 / DRIFT_PPM) - 1;
                let recv = heard + held + back;
                let charge: Hop = d.arrived(tx, (echoed || i == 0).then_some(echo), recv);
                let (longest, shortest) = (charge.longest.0, charge.shortest.0);
                prop_assert!(charge.is_proven && longest >= back, "trip {i}: {longest} for {back}");
                prop_assert!(shortest <= back, "trip {i}: at least {shortest} for {back}");
                now = recv + 100;
            }
        }

        #[test]
        fn any_clocks_are_survived(samples in proptest::collection::vec((any::<u64>(), any::<Option<u64>>(), any::<u64>()), 1..20)) {
            let mut d = LinkDelay::new(Ticks(u64::MAX));
            for (tx, echo, recv) in samples {
                d.arrived(tx, echo, recv);
            }
        }
    }
}
