//! The safety margin of a `waitfor` in closed form (D2, D56).

use crate::ticks::Ticks;

/// The least time that must remain of every arrival for a member to release, so that while each packet takes at most
/// `delay` and at most `losses` packets of the meeting are lost, nobody is released while another gives up.
///
/// The releasing member sends its CONFIRM at once and then `losses` times more, `resend` apart. The last copy leaves
/// `losses x resend` after the release and takes `delay`; each copy may leave one `tick` late. The model checker
/// searches for the least margin that holds and shows it beside this one, which must never be smaller.
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
    fn without_losses_the_period_does_not_matter_and_nothing_overflows() {
        assert_eq!(least_margin(Ticks(5), 0, Ticks::FAR, Ticks(1)), Ticks(6));
        assert_eq!(least_margin(Ticks(5), 255, Ticks::FAR, Ticks(1)), Ticks::FAR);
    }
}
