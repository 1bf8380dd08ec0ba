//! The clock that all processes of one machine share.

use rustix::time::{ClockId, clock_gettime};

/// `CLOCK_BOOTTIME` in microseconds, as the nodes read it (D153). The launcher compares times of several nodes, because
/// they run on one machine, and so measures start skews and orders events. The protocol never compares such times.
pub fn now_us() -> u64 {
    let now = clock_gettime(ClockId::Boottime);
    let whole = u64::try_from(now.tv_sec).unwrap_or_default() * 1_000_000;
    whole + u64::try_from(now.tv_nsec).unwrap_or_default() / 1_000
}
