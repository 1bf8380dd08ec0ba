//! Margins in closed form: for a `waitfor` (D2, D56), and for a lease and its take-over (D30, D61).

use crate::ticks::Ticks;

/// The greatest difference in speed between the clocks of two nodes, in parts per million: twice the specified tolerance of
/// cheap oscillators.
pub const DRIFT_PPM: u64 = 200;

/// How much longer than the lease the standby of a couple must wait, so that the two never act at the same time.
///
/// The lease counts from the sending of an answer, and the take-over counts from its arrival. The arrival is no earlier, so
/// the link delay needs no margin. The margin is the sum of three parts: the `drift` over both waits; the `tick` by which
/// the holder may notice the end of its lease late; and `residence`, the longest time that the holder's last command may
/// stay under way on its port.
#[must_use]
pub fn takeover_margin(
    lease: Ticks,
    takeover: Ticks,
    drift_ppm: u64,
    residence: Ticks,
    tick: Ticks,
) -> Ticks {
    let both = lease + takeover;
    let drift = Ticks(both.0.saturating_mul(drift_ppm).div_ceil(1_000_000));
    if both == Ticks::FAR { Ticks::FAR } else { drift + residence + tick }
}

/// The shortest lease that never ends while no packet is lost: heartbeats every `every`, link delays up to `delay` (D78).
///
/// The lease must last while one answer is the newest echoed one. The heartbeat that echoes this answer leaves a round trip
/// and at most a period after the answer. The heartbeat that echoes the next answer leaves a period later, and takes
/// `delay`. A node may act up to a `tick` late.
#[must_use]
pub fn least_lease(delay: Ticks, every: Ticks, tick: Ticks) -> Ticks {
    let heartbeats = (delay + delay).0 / every.0.max(1);
    Ticks(every.0.saturating_mul(heartbeats.saturating_add(2))) + delay + tick
}

/// The least patience that every arrival must have left when a member releases. If each packet takes at most `delay`, and at
/// most `losses` packets of the meeting are lost, then no member is released while another one gives up.
///
/// The releasing member sends its CONFIRM at once and `losses` more copies, `resend` apart. The last copy leaves `losses x
/// resend` after the release and takes `delay`; each copy may leave one `tick` late. The model checker searches for the
/// least margin that holds and shows it beside the closed form, which must never be smaller.
#[must_use]
pub fn least_margin(delay: Ticks, losses: u8, resend: Ticks, tick: Ticks) -> Ticks {
    if losses == 0 {
        return delay + tick;
    }
    let copies = u64::from(losses);
    let waits = Ticks(resend.0.saturating_mul(copies)) + Ticks(tick.0.saturating_mul(copies));
    delay + waits + tick
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_margin_is_the_way_and_a_period_for_each_loss_with_a_tick_for_each_copy() {
        let margin = |losses| least_margin(Ticks(5), losses, Ticks(20), Ticks(1));
        assert_eq!([0, 1, 2].map(margin), [Ticks(6), Ticks(27), Ticks(48)]);
    }

    #[test]
    fn a_takeover_waits_for_the_drift_of_both_clocks_a_tick_and_what_was_sent_last() {
        let margin =
            |residence| takeover_margin(Ticks(100_000), Ticks(400_000), DRIFT_PPM, residence, Ticks(1_000));
        assert_eq!(margin(Ticks::ZERO), Ticks(1_100));
        assert_eq!(margin(Ticks(20_000)), Ticks(21_100));
        assert_eq!(takeover_margin(Ticks::FAR, Ticks(1), 200, Ticks::ZERO, Ticks(1)), Ticks::FAR);
    }

    #[test]
    fn a_lease_lasts_two_periods_a_way_and_what_the_way_there_and_back_adds() {
        let least = |delay, every| least_lease(Ticks(delay), Ticks(every), Ticks(1));
        assert_eq!([(1, 2), (2, 3), (2, 2), (1, 3)].map(|(w, e)| least(w, e).0), [8, 12, 11, 8]);
        assert_eq!(least(1, 0), Ticks(2));
        assert_eq!(least(1, u64::MAX), Ticks::FAR);
    }

    #[test]
    fn without_losses_the_period_does_not_matter_and_nothing_overflows() {
        assert_eq!(least_margin(Ticks(5), 0, Ticks::FAR, Ticks(1)), Ticks(6));
        assert_eq!(least_margin(Ticks(5), 255, Ticks::FAR, Ticks(1)), Ticks::FAR);
    }
}
