//! Computes how long a datagram waited in the kernel (D50).
//!
//! The kernel stamps a datagram with the *wall clock* when it arrives, and the wall clock may be set at any time. So
//! a stamp counts only if the wall clock and the monotonic clock advanced equally since the socket was last seen
//! empty. Otherwise that whole time counts as waiting, because the datagram may have arrived at any moment since then,
//! but not earlier.

use crate::clock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// By how many nanoseconds the clocks' difference may change through rounding alone.
const ROUNDING: i128 = 1_000;
/// The longest time that a reading of the clocks may take. A reading that took longer was interrupted, and is repeated.
const INTERRUPTED: Duration = Duration::from_micros(20);
const ATTEMPTS: usize = 4;

/// Both clocks, read one after the other: the wall clock at some moment between the two monotonic instants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// The monotonic clock, just before the wall clock was read.
    pub before: Instant,
    /// The wall clock: the time since 1970 (a clock set to earlier reads as 1970).
    pub realtime: Duration,
    /// The monotonic clock, just after the wall clock was read.
    pub after: Instant,
    /// For how long the machine had been suspended since it started, as far as this process knew, in microseconds.
    pub suspended: u64,
}

impl Reading {
    /// Reads the clocks.
    #[must_use]
    pub fn take() -> Self {
        let mut reading = Self::once();
        for _ in 1..ATTEMPTS {
            if reading.width() <= INTERRUPTED {
                break;
            }
            reading = Self::once();
        }
        reading
    }

    fn once() -> Self {
        let before = Instant::now();
        let realtime = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { before, realtime, after: Instant::now(), suspended: clock::suspended() }
    }

    /// How far apart the two monotonic instants are: the uncertainty of when the wall clock was read.
    fn width(&self) -> Duration {
        self.after.saturating_duration_since(self.before)
    }
}

/// How long a datagram waited in the kernel, and whether the kernel's time stamp could be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Residency {
    /// The time that the datagram waited, never less than the true time.
    pub waited: Duration,
    /// The evidence on which that time rests.
    pub by: Evidence,
}

/// The evidence on which a [`Residency`] rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// The kernel's stamp shows how long the datagram waited.
    Stamp,
    /// The kernel gave no stamp, so the time since the socket was last seen empty counts.
    NoStamp,
    /// The wall clock was set since the socket was last seen empty, so the time since then counts.
    ClockSet,
}

/// How long a datagram waited in the kernel, which stamped it at `stamp` (wall clock, since 1970). The thread received
/// the datagram before `now`. The datagram arrived after `empty`, when the socket was seen empty.
#[must_use]
pub fn residency(now: &Reading, stamp: Option<Duration>, empty: &Reading) -> Residency {
    let longest = now.after.saturating_duration_since(empty.before);
    let Some(stamp) = stamp else {
        return Residency { waited: longest, by: Evidence::NoStamp };
    };
    let waited = now.realtime.checked_sub(stamp).filter(|_| !clock_was_set(now, empty));
    // The widths of the two readings are added, because they may hide a small step of the wall clock.
    let waited = waited.map(|waited| (waited + now.width() + empty.width()).min(longest));
    match waited {
        Some(waited) => Residency { waited, by: Evidence::Stamp },
        None => Residency { waited: longest, by: Evidence::ClockSet },
    }
}

/// Whether the clocks advanced differently between two readings. Each reading gives a range for the clocks'
/// difference. If the clocks advanced equally, the two ranges overlap.
fn clock_was_set(now: &Reading, then: &Reading) -> bool {
    let nanoseconds = |d: Duration| i128::try_from(d.as_nanos()).unwrap_or(i128::MAX);
    let realtime = nanoseconds(now.realtime) - nanoseconds(then.realtime);
    let least = nanoseconds(now.before.saturating_duration_since(then.after));
    let most = nanoseconds(now.after.saturating_duration_since(then.before));
    realtime < least - ROUNDING || realtime > most + ROUNDING
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const EPOCH: u64 = 1_700_000_000_000_000;

    /// A reading of both clocks, `mono` microseconds after `origin`, with the wall clock at `wall` microseconds past
    /// [`EPOCH`].
    fn reading(origin: Instant, mono: u64, wall: u64, width: u64) -> Reading {
        let at = |us| origin + Duration::from_micros(us);
        let realtime = Duration::from_micros(EPOCH + wall);
        Reading { before: at(mono), realtime, after: at(mono + width), suspended: 0 }
    }

    fn stamp(wall: u64) -> Option<Duration> {
        Some(Duration::from_micros(EPOCH + wall))
    }

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    #[test]
    fn a_stamp_is_believed_while_the_clocks_go_on_alike() {
        let o = Instant::now();
        let (empty, now) = (reading(o, 0, 0, 0), reading(o, 500_000, 500_000, 0));
        let by_stamp = |waited| Residency { waited, by: Evidence::Stamp };
        assert_eq!(residency(&now, stamp(200_000), &empty), by_stamp(ms(300)));
        assert_eq!(residency(&now, stamp(500_000), &empty), by_stamp(ms(0)));
        assert_eq!(
            residency(&now, Some(Duration::from_micros(EPOCH - 7)), &empty),
            by_stamp(ms(500)),
            "it cannot have come before the socket was empty"
        );
    }

    #[test]
    fn interrupted_readings_only_add() {
        let o = Instant::now();
        let (empty, now) = (reading(o, 0, 1_000, 4_000), reading(o, 500_000, 502_000, 3_000));
        assert_eq!(residency(&now, stamp(202_000), &empty).waited, ms(307));
    }

    #[test]
    fn a_clock_that_was_set_is_not_believed() {
        let o = Instant::now();
        let empty = reading(o, 0, 0, 0);
        for wall in [100_000, 499_900, 500_100, 90_000_000] {
            let now = reading(o, 500_000, wall, 0);
            let got = residency(&now, stamp(wall.min(90_000)), &empty);
            assert_eq!(got, Residency { waited: ms(500), by: Evidence::ClockSet }, "wall clock at {wall}");
        }
        // The wall clock was set forward and back between the two readings: the stamp lies in the future.
        let now = reading(o, 500_000, 500_000, 0);
        assert_eq!(residency(&now, stamp(3_600_000_000), &empty).by, Evidence::ClockSet);
    }

    #[test]
    fn without_a_stamp_everything_since_the_socket_was_empty_is_charged() {
        let o = Instant::now();
        let got = residency(&reading(o, 700_000, 5, 0), None, &reading(o, 0, 0, 0));
        assert_eq!(got, Residency { waited: ms(700), by: Evidence::NoStamp });
    }

    #[test]
    fn real_readings_of_undisturbed_clocks_are_believed() {
        let empty = Reading::take();
        let stamp = SystemTime::now().duration_since(UNIX_EPOCH).ok();
        std::thread::sleep(ms(5));
        let got = residency(&Reading::take(), stamp, &empty);
        assert!(got.waited >= ms(5), "{got:?}");
    }

    proptest! {
        /// The test sets the wall clock by any amount at any moment. The computed wait is never less than the true one
        /// (except for tolerated rounding), and never more than the time since the socket was seen empty.
        #[test]
        fn never_too_little(
            arrival in 1..1_000_000_u64, wait in 0..1_000_000_u64, step_at in 0..2_000_000_u64,
            step in -2_000_000..2_000_000_i64, widths in (0..20_u64, 0..20_u64),
        ) {
            let o = Instant::now();
            let wall = |mono: u64| {
                let past = if mono >= step_at { step } else { 0 };
                u64::try_from(10_000_000 + i64::try_from(mono).unwrap() + past).unwrap()
            };
            let empty = reading(o, 0, wall(0), widths.0);
            let end = arrival + widths.0 + wait;
            let now = reading(o, end, wall(end), widths.1);
            let got = residency(&now, stamp(wall(arrival + widths.0)), &empty).waited;
            prop_assert!(got + Duration::from_micros(1) >= Duration::from_micros(wait));
            prop_assert!(got <= Duration::from_micros(end + widths.1));
        }
    }
}
