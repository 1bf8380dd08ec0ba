//! The monitor's clock: the time since its start. Only the main loop reads this clock; all other code gets the time as
//! an argument.

use std::fmt;
use std::time::{Duration, Instant};

/// An instant on the monitor's own clock: the time since it started.
pub type Moment = Duration;

/// The source of moments: the system's monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
}

impl Clock {
    /// A clock that starts now.
    #[must_use]
    pub fn start() -> Self {
        Self { start: Instant::now() }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Moment {
        self.start.elapsed()
    }
}

/// A moment or length of time in whole microseconds.
pub(crate) fn micros(length: Duration) -> u64 {
    u64::try_from(length.as_micros()).unwrap_or(u64::MAX)
}

/// A length of time for people, in at most six columns: `850us`, `7ms`, `1.20s`, `4m12s`, `3h05m`, `12d`.
#[derive(Clone, Copy, Debug)]
pub struct Span(pub Duration);

impl Span {
    /// A span of this many microseconds.
    #[must_use]
    pub const fn micros(us: u64) -> Self {
        Self(Duration::from_micros(us))
    }

    /// The span as a text that changes once a second at most, so that an age by itself causes no thirty frames a second.
    #[must_use]
    pub fn in_seconds(self) -> String {
        match self.0.as_secs() {
            seconds @ 0..60 => format!("{seconds}s"),
            _ => self.to_string(),
        }
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = self.0.as_micros();
        let (ms, seconds) = (us / 1000, us / 1_000_000);
        let (minutes, hours) = (seconds / 60, seconds / 3600);
        let text = match us {
            0..1000 => format!("{us}us"),
            1000..1_000_000 => format!("{ms}ms"),
            1_000_000..60_000_000 => format!("{seconds}.{:02}s", ms % 1000 / 10),
            60_000_000..3_600_000_000 => format!("{minutes}m{:02}s", seconds % 60),
            3_600_000_000..360_000_000_000 => format!("{hours}h{:02}m", minutes % 60),
            _ => format!("{}d", hours / 24),
        };
        f.pad(&text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_short_and_round_down() {
        let shown = |us| Span::micros(us).to_string();
        let cases =
            [(0, "0us"), (999, "999us"), (7_999, "7ms"), (1_209_000, "1.20s"), (252_000_000, "4m12s")];
        for (us, text) in cases {
            assert_eq!(shown(us), text);
        }
        assert_eq!(shown(11_100_000_000), "3h05m");
        assert_eq!(
            [0, 999_999, 59_999_999, 61_000_000].map(|us| Span::micros(us).in_seconds()),
            ["0s", "0s", "59s", "1m01s"]
        );
        assert_eq!(shown(1_036_800_000_000), "12d");
        assert!(shown(u64::MAX).len() < 12);
    }
}
