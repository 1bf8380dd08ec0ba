//! Two things outside of the program on which a measurement depends: how near the two processors are to each other, and
//! how much of them other programs take.

use crate::cases::floors;
use crate::cores;
use crate::suite::Effort;
use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// Two processors count as near if passing a cache line from one to the other and back takes at most this many
/// nanoseconds. On the machines seen so far, two threads of one core take up to 80 ns, and two cores at least 230 ns.
pub const NEAR_NANOS: f64 = 130.0;
/// How often the cache line is passed to measure this time.
const TRIPS: u32 = 64 * floors::GROUP;
/// The length of a tick in `/proc/stat`, which does not depend on the length of the kernel's own tick.
const TICK: Duration = Duration::from_millis(10);

/// How far the two processors are from each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Apart {
    /// The processors are as close as two threads of one core.
    Near,
    /// The processors are as far apart as two cores.
    Far,
}

impl Apart {
    /// The word for the distance in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Far => "far",
        }
    }

    /// The distance of the two processors, if a cache line takes `nanos` nanoseconds to the other one and back.
    #[must_use]
    pub fn of(nanos: f64) -> Self {
        if nanos <= NEAR_NANOS { Self::Near } else { Self::Far }
    }
}

/// Observes the machine during a measurement.
pub trait Surroundings {
    /// How far the two processors are from each other now; `None` if there is only one.
    fn apart(&mut self) -> Option<Apart>;
    /// The share of the processors, 0 to 1, that other programs and other virtual machines took since the last call.
    fn others(&mut self) -> f64;
}

/// The machine on which this program runs.
#[derive(Debug)]
pub struct Here {
    at: Instant,
    all: Duration,
    own: Duration,
}

impl Here {
    /// Begins to observe the machine.
    #[must_use]
    pub fn now() -> Self {
        Self { at: Instant::now(), all: all(), own: own() }
    }
}

impl Surroundings for Here {
    fn apart(&mut self) -> Option<Apart> {
        let line = || floors::spinning_line(Effort::Times(TRIPS));
        (cores::count() > 1).then(|| Apart::of(line().p50))
    }

    fn others(&mut self) -> f64 {
        let now = Self::now();
        let taken = (now.all - self.all).saturating_sub(now.own - self.own);
        let whole = (now.at - self.at).as_secs_f64() * cores::processors() as f64;
        *self = now;
        if whole > 0.0 { (taken.as_secs_f64() / whole).min(1.0) } else { 0.0 }
    }
}

/// The time that all programs have taken on all processors, and the time that other virtual machines took
/// from this one (stolen time).
fn all() -> Duration {
    let stat = std::fs::read_to_string("/proc/stat").unwrap_or_default();
    busy(&stat)
}

fn busy(stat: &str) -> Duration {
    // The numbers in this line are: user nice system idle iowait irq softirq steal.
    let numbers = stat.lines().next().unwrap_or_default().split_whitespace().skip(1);
    let ticks: Vec<u32> = numbers.filter_map(|number| number.parse().ok()).collect();
    let of = |at: usize| ticks.get(at).copied().unwrap_or_default();
    [0, 1, 2, 5, 6, 7].into_iter().map(of).map(|ticks| TICK * ticks).sum()
}

/// The processor time that this process has taken.
fn own() -> Duration {
    let taken = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(taken.tv_sec.unsigned_abs(), u32::try_from(taken.tv_nsec).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_is_not_busy_and_what_was_stolen_is() {
        let stat = "cpu  1 2 4 1000 2000 8 16 32 7 7\ncpu0 9 9 9 9\n";
        assert_eq!(busy(stat), TICK * 63);
        assert_eq!(busy(""), Duration::ZERO);
    }

    #[test]
    fn others_take_a_share_and_near_ends_at_its_bound() {
        let mut here = Here::now();
        std::thread::sleep(Duration::from_millis(30));
        let share = here.others();
        assert!((0.0..=1.0).contains(&share), "{share}");
        assert!(here.at.elapsed() < Duration::from_secs(60) && here.all >= here.own / 2);
        assert_eq!([NEAR_NANOS, NEAR_NANOS + 1.0].map(Apart::of), [Apart::Near, Apart::Far]);
    }
}
