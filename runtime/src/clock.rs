//! The node's one clock: `CLOCK_MONOTONIC`. Wall-clock time is never asked for here (D37).

use rustix::time::{ClockId, Timespec};
use std::time::Duration;

/// An instant on the monotonic clock, in whole microseconds: the runtime's [`Ticks`](imrs_protocol::Ticks) (D42).
pub(crate) type Micros = u64;

/// Later than every instant.
pub(crate) const FAR: Micros = u64::MAX;

const NANOS_PER_SECOND: u64 = 1_000_000_000;
const NANOS_PER_MICRO: u64 = 1_000;

fn nanos() -> u64 {
    nanos_on(ClockId::Monotonic)
}

fn nanos_on(clock: ClockId) -> u64 {
    let now = rustix::time::clock_gettime(clock);
    let seconds = u64::try_from(now.tv_sec).unwrap_or_default();
    seconds * NANOS_PER_SECOND + u64::try_from(now.tv_nsec).unwrap_or_default()
}

/// The last whole microsecond: for everything that happens to a task.
pub(crate) fn now() -> Micros {
    nanos() / NANOS_PER_MICRO
}

/// The next whole microsecond: for what a task asks, so that no time_out ever ends early by the rounding.
pub(crate) fn next() -> Micros {
    nanos().div_ceil(NANOS_PER_MICRO)
}

/// The last whole microsecond of `CLOCK_BOOTTIME`, which goes on while the machine is suspended: for processes beside the node.
pub(crate) fn boottime() -> Micros {
    nanos_on(ClockId::Boottime) / NANOS_PER_MICRO
}

/// An instant of the monotonic clock on `CLOCK_BOOTTIME`. It is never later than the true one: that clock is read first and rounded down, and a
/// suspension that is still to come only brings it nearer.
pub(crate) fn on_boottime(at: Micros) -> Micros {
    let now = boottime();
    now.saturating_add(at).saturating_sub(next())
}

/// An instant as the kernel wants it, or `None` where it never comes.
pub(crate) fn nanos_of(at: Micros) -> Option<u64> {
    at.checked_mul(NANOS_PER_MICRO)
}

/// Nanoseconds of the monotonic clock as the kernel wants them.
pub(crate) fn timespec(nanos: u64) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(nanos / NANOS_PER_SECOND).unwrap_or(i64::MAX),
        tv_nsec: i64::try_from(nanos % NANOS_PER_SECOND).unwrap_or_default(),
    }
}

/// A length in whole microseconds, rounded up: nothing ends early.
pub(crate) fn micros(length: Duration) -> Micros {
    u64::try_from(length.as_nanos().div_ceil(u128::from(NANOS_PER_MICRO))).unwrap_or(FAR)
}

/// Asks the kernel to end this thread's sleeps on time instead of up to 50 us late, which is its default.
pub(crate) fn sleep_exactly() {
    // Refused only by a kernel without the call; sleeps are then as late as they are.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_round_up_and_end_at_the_far_end() {
        assert_eq!(micros(Duration::from_nanos(1)), 1);
        assert_eq!(micros(Duration::from_micros(7)), 7);
        assert_eq!(micros(Duration::MAX), FAR);
        assert_eq!(nanos_of(FAR), None);
        assert_eq!(nanos_of(3), Some(3_000));
    }

    #[test]
    fn an_instant_on_the_clock_of_other_processes_is_never_later_than_it_is() {
        for ahead in [0, 1, 1_000_000] {
            let at = next() + ahead;
            let there = on_boottime(at);
            // Both clocks are read again, in the other order: the difference is at most what passed meanwhile.
            let (mono, boot) = (nanos(), nanos_on(ClockId::Boottime));
            assert!(
                i128::from(there) * 1_000 - i128::from(boot) <= i128::from(at) * 1_000 - i128::from(mono)
            );
        }
        assert!(boottime() > on_boottime(now() - 1_000_000));
    }

    #[test]
    fn a_request_is_never_stamped_before_it_was_made() {
        for _ in 0..1_000 {
            let before = nanos();
            assert!(next() * NANOS_PER_MICRO >= before);
            assert!(now() * NANOS_PER_MICRO <= nanos());
        }
    }
}
