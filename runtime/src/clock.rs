//! The node's only clock: `CLOCK_BOOTTIME`, never wall-clock time (D37).
//!
//! This clock runs on while the machine is suspended, and so do leases, time_outs and timers: a suspend counts as a
//! pause of the node (D153). Futex sleeps use `CLOCK_MONOTONIC`, which stands still during a suspend. An instant is
//! converted to `CLOCK_MONOTONIC` only where a thread goes to sleep, and a woken thread reads `CLOCK_BOOTTIME` again.
//!
//! Between two sleeps of a thread the time comes from the processor's counter, if the kernel keeps its own time by that
//! counter (D197).

// The module is named by its path, because a test includes this file under another path.
#[path = "clock/counter.rs"]
mod counter;

use counter::{Anchor, Between, Clocks, Counter};
use rustix::time::{ClockId, Timespec};
use std::cell::Cell;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

/// An instant on the node's clock, in whole microseconds: the runtime's [`Ticks`](imrs_protocol::Ticks) (D42).
pub(crate) type Micros = u64;

/// Later than every instant.
pub(crate) const FAR: Micros = u64::MAX;

const NANOS_PER_SECOND: u64 = 1_000_000_000;
const NANOS_PER_MICRO: u64 = 1_000;

/// The greatest difference (ns) at which a measured offset still counts as the known one: the two clocks are read one
/// after the other, not at once.
const READ_APART: u64 = 10 * NANOS_PER_MICRO;

/// The last known offset of `CLOCK_BOOTTIME` from `CLOCK_MONOTONIC`, in nanoseconds. Only a suspend changes it. It is negative
/// only in a time namespace.
static AHEAD: AtomicI64 = AtomicI64::new(0);

fn read(clock: ClockId) -> u64 {
    let now = rustix::time::clock_gettime(clock);
    let seconds = u64::try_from(now.tv_sec).unwrap_or_default();
    seconds * NANOS_PER_SECOND + u64::try_from(now.tv_nsec).unwrap_or_default()
}

fn nanos() -> u64 {
    read(ClockId::Boottime)
}

/// The file that names the clock by which the kernel keeps time.
const KEPT_BY: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
/// The environment variable that, set to `kernel`, makes a process read the kernel's clock alone.
const CLOCK: &str = "IMRS_CLOCK";
/// The names, in the file [`KEPT_BY`], of the counters that `quanta` reads.
const COUNTERS: [&str; 2] = ["tsc", "arch_sys_counter"];

/// The clocks of this machine: the kernel's, and the processor's counter if the process uses it.
struct Here(Option<quanta::Clock>);

impl Clocks for Here {
    fn kernel(&self) -> u64 {
        nanos()
    }
    fn count(&self) -> u64 {
        self.0.as_ref().map_or(0, quanta::Clock::raw)
    }
}

thread_local! {
    static ANCHOR: Cell<Anchor> = const { Cell::new(Anchor::NONE) };
}

fn here() -> &'static (Here, Counter) {
    static HERE: OnceLock<(Here, Counter)> = OnceLock::new();
    HERE.get_or_init(|| {
        let kept_by = std::fs::read_to_string(KEPT_BY).unwrap_or_default();
        let is_asked_for = std::env::var_os(CLOCK).is_none_or(|asked| asked != "kernel");
        let usable = is_asked_for && COUNTERS.contains(&kept_by.trim());
        // Done only if the counter is usable: when `quanta` makes a clock, it first measures a rate of its own, which
        // takes time.
        let here = Here(usable.then(quanta::Clock::new));
        let counter = Counter::new(&here, usable);
        (here, counter)
    })
}

/// Whether the time between two sleeps of a thread comes from the processor's counter.
pub(crate) fn is_by_counter() -> bool {
    here().1.is_trusted()
}

/// The earliest and the latest possible value of the current time.
fn bounds() -> Between {
    let (here, counter) = here();
    ANCHOR.with(|anchor| counter.read(here, anchor))
}

/// Measures the offset between the two clocks of the kernel, stores and returns it.
fn ahead() -> i64 {
    let known = AHEAD.load(Ordering::Relaxed);
    let (before, boot) = (read(ClockId::Monotonic), nanos());
    if apart(boot, before).abs_diff(known) <= READ_APART {
        return known;
    }
    // If the offset differs from the known one, the machine was suspended, or this thread was preempted between two
    // readings.
    let ahead = between(known, before, boot, read(ClockId::Monotonic));
    AHEAD.store(ahead, Ordering::Relaxed);
    ahead
}

const fn apart(boot: u64, monotonic: u64) -> i64 {
    boot.wrapping_sub(monotonic).cast_signed()
}

/// The offset of the two clocks of the kernel. `CLOCK_BOOTTIME` read `boot` between the readings `before` and `after`
/// of `CLOCK_MONOTONIC`. These readings bound the offset, and `known` is clamped to the bounds. If the thread was
/// preempted between the readings, the bounds are wide, and `known` stays.
fn between(known: i64, before: u64, boot: u64, after: u64) -> i64 {
    known.clamp(apart(boot, after), apart(boot, before))
}

/// How long the machine has been suspended since it started, as far as this process has noticed.
pub(crate) fn suspended() -> Micros {
    u64::try_from(AHEAD.load(Ordering::Relaxed)).unwrap_or_default() / NANOS_PER_MICRO
}

/// Measures the offset of the clocks anew, and returns what [`suspended`] returns then.
pub(crate) fn look_for_suspend() -> Micros {
    ahead();
    suspended()
}

/// The current time, rounded down to a microsecond: the stamp of everything that happens to a task.
pub(crate) fn now() -> Micros {
    bounds().earliest / NANOS_PER_MICRO
}

/// The current time, rounded up to a microsecond: the stamp of a task's requests, so that rounding never shortens a time_out.
pub(crate) fn next() -> Micros {
    bounds().latest.div_ceil(NANOS_PER_MICRO)
}

/// As [`now`], by the kernel's clock alone. The counter may stop while the machine is suspended, and a thread that
/// was running does not notice while it uses its anchor. So this function decides whether a lease has ended.
pub(crate) fn now_by_kernel() -> Micros {
    nanos() / NANOS_PER_MICRO
}

/// As [`next`], by the kernel's clock alone.
pub(crate) fn next_by_kernel() -> Micros {
    nanos().div_ceil(NANOS_PER_MICRO)
}

/// Makes the calling thread read the kernel's clock after its sleep, which begins now. Every thread that uses this
/// clock must call this before it sleeps.
pub(crate) fn sleeps() {
    ANCHOR.with(counter::renew);
}

/// Whether [`sleeps`] was called during `sleep`.
#[cfg(test)]
pub(crate) fn is_told_of(sleep: impl FnOnce()) -> bool {
    ANCHOR.set(Anchor::in_use());
    sleep();
    ANCHOR.get() != Anchor::in_use()
}

/// Converts an instant to nanoseconds of `CLOCK_MONOTONIC`; `None` if the instant never comes.
pub(crate) fn nanos_of(at: Micros) -> Option<u64> {
    let at = at.checked_mul(NANOS_PER_MICRO)?;
    Some(at.saturating_sub_signed(ahead()))
}

/// Converts an instant for a kernel timer on `CLOCK_BOOTTIME`; `None` if it never comes. `CLOCK_BOOTTIME` is the node's
/// own clock, so no offset is subtracted.
pub(crate) fn boottime(at: Micros) -> Option<Timespec> {
    at.checked_mul(NANOS_PER_MICRO).map(timespec)
}

/// Nanoseconds as the kernel takes them: an instant on either clock, or a duration.
pub(crate) fn timespec(nanos: u64) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(nanos / NANOS_PER_SECOND).unwrap_or(i64::MAX),
        tv_nsec: i64::try_from(nanos % NANOS_PER_SECOND).unwrap_or_default(),
    }
}

/// A duration in whole microseconds, rounded up so that nothing ends early.
pub(crate) fn micros(length: Duration) -> Micros {
    u64::try_from(length.as_nanos().div_ceil(u128::from(NANOS_PER_MICRO))).unwrap_or(FAR)
}

/// Asks the kernel to end this thread's sleeps on time instead of up to 50 us late, which is its default.
pub(crate) fn sleep_exactly() {
    // This call fails only on a kernel that lacks it; sleeps then stay up to 50 us late.
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
    }

    #[test]
    fn a_sleep_ends_when_the_nodes_clock_is_there() {
        let at = now() + 1_000_000;
        let monotonic = read(ClockId::Monotonic);
        let left = nanos_of(at).expect("an instant") - monotonic;
        // This thread may have been preempted between the two readings. The machine was not suspended, as none is
        // during a test.
        assert!(left <= 1_000_000_000 + READ_APART, "{left} ns");
        assert_eq!(nanos_of(at), nanos_of(at));
    }

    #[test]
    fn a_timer_of_the_nodes_own_clock_has_the_instant_itself() {
        // `nanos_of` would subtract the time for which the machine was suspended, so the timer of a guard would expire
        // too early.
        for at in [1, 1_000_001, 3_600_000_000, FAR / NANOS_PER_MICRO] {
            let due = boottime(at).expect("an instant");
            let nanos = i128::from(due.tv_sec) * i128::from(NANOS_PER_SECOND) + i128::from(due.tv_nsec);
            assert_eq!(nanos, i128::from(at) * i128::from(NANOS_PER_MICRO));
        }
        assert!(boottime(FAR).is_none());
    }

    #[test]
    fn a_suspend_is_seen_once_and_a_stop_between_two_readings_is_none() {
        const HOUR: u64 = 3_600 * NANOS_PER_SECOND;
        let hour = HOUR.cast_signed();
        assert_eq!(between(0, 1_000, 1_030, 1_060), 0, "nothing has happened");
        assert_eq!(between(0, 1_000, 900_001_030, 900_001_060), 0, "this thread was stopped");
        assert_eq!(between(0, 1_000, 1_030 + HOUR, 1_060), hour - 30, "the machine was suspended");
        assert_eq!(between(hour - 30, 2_000, 2_010 + HOUR, 2_500), hour - 30, "that is known");
        assert_eq!(between(hour - 30, 3_000, 3_000 + HOUR, 3_010), hour - 10, "known better");
        assert_eq!(between(0, 5_000 + HOUR, 5_020, 5_060 + HOUR), 20 - hour, "in a time namespace");
    }

    #[test]
    fn what_decides_about_a_lease_knows_of_a_suspend_at_once() {
        const LONG: u64 = 10 * NANOS_PER_SECOND;
        let (here, counter) = here();
        while counter.is_trusted() && !ANCHOR.with(|anchor| counter.is_in_use(anchor)) {
            bounds();
        }
        // The anchor of this thread is as after a suspend during which the counter stopped.
        ANCHOR.set(Anchor::as_before(LONG, here));
        let kernel = nanos();
        assert!(now_by_kernel() >= kernel / NANOS_PER_MICRO && next_by_kernel() * NANOS_PER_MICRO >= kernel);
        if counter.is_trusted() {
            assert!(now() * NANOS_PER_MICRO < kernel - LONG / 2, "the counter does not know it");
        }
        sleeps();
        assert!(now() * NANOS_PER_MICRO + NANOS_PER_MICRO >= kernel, "after a sleep it does");
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
