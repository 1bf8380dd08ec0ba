//! How long a message may have to wait for its service, in closed form (D58, D59).
//!
//! What a task declares bounds how often a message can be passed over: a head by GETs over all ports, an offer by rank.
//! Times the longest service this is a time, and a message whose life is longer is served. The model checker searches
//! for the least life that is served and shows it beside this one, which must never be smaller.

use crate::ticks::Ticks;

/// What decides how long a message waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Service {
    /// The ports of the receiving task, those that it sends on included.
    pub ports: u16,
    /// How many things its `order` names.
    pub levels: u8,
    /// The rank of the message: how many levels stand above it. Only for ports with a handler.
    pub rank: u8,
    /// How many messages may stand before it in its own port: at most `bounded_buffer - 1` where all of them live alike.
    pub ahead: u16,
    /// How many messages that were refused before it may stand in other ports with a handler: the sum of the
    /// `bounded_buffer`s of those whose messages can be refused, too. Only for ports with a handler.
    pub rivals: u16,
    /// The longest time from one GET to the next; for ports with a handler, the longest time that the task and the
    /// handlers go without a wait, a boundary or a return.
    pub longest: Ticks,
    /// The time penalty of the port, or the cell's tick where it has none. Only for ports with a handler.
    pub penalty: Ticks,
}

/// How many times the head of a port is passed over before it goes first (D58).
#[must_use]
pub const fn bypass_limit(ports: u16, levels: u8) -> u16 {
    let each = ports.saturating_add(levels as u16);
    if each > 4 { each } else { 4 }
}

impl Service {
    /// How often the head of a port can be bypassed by GETs over all ports: when its turn has come, all other ports may
    /// have waited for theirs longer.
    #[must_use]
    pub const fn most_bypasses(&self) -> u16 {
        bypass_limit(self.ports, self.levels).saturating_add(self.ports.saturating_sub(1))
    }

    /// How often a message can be refused by rank, while no handler waits, before it outranks the task's own thread.
    #[must_use]
    pub const fn most_refusals(&self) -> u8 {
        if self.rank == 0 { 1 } else { self.rank }
    }

    /// The life that is long enough for a message of a port without a handler, which GETs over all ports serve.
    ///
    /// Each message that stands before it, and it itself, is taken after at most [`most_bypasses`](Self::most_bypasses)
    /// others; what is being served when it arrives ends first.
    #[must_use]
    pub fn bound_by_gets(&self) -> Ticks {
        let gets = (u64::from(self.most_bypasses()) + 1).saturating_mul(u64::from(self.ahead) + 1);
        Ticks(gets.saturating_mul(self.longest.0)) + Ticks(1)
    }

    /// The life that is long enough for a message of a port with a handler that outranks the thread only at its cap
    /// (D76): no rank stands between its own, raised to the first one, and that of `self`. Handlers do not wait.
    ///
    /// It is refused at most [`most_refusals`](Self::most_refusals) times, and each time offered again when the penalty
    /// is over and the task can be interrupted. Then it waits for those that were refused before it, of whatever port,
    /// and before each of them and itself for one that outranks the thread without being refused.
    #[must_use]
    pub fn bound(&self) -> Ticks {
        let refusals = u64::from(self.most_refusals());
        let refused = refusals.saturating_mul(self.penalty.0.saturating_add(self.longest.0));
        let before = u64::from(self.ahead) + u64::from(self.rivals);
        // The first one is under way when the message comes.
        let turns = 1 + 2 * before + 1;
        Ticks(refused) + Ticks(turns.saturating_mul(self.longest.0)) + Ticks(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: Service =
        Service { ports: 2, levels: 0, rank: 0, ahead: 0, rivals: 0, longest: Ticks(1), penalty: Ticks(2) };

    #[test]
    fn gets_pass_a_head_over_four_times_and_once_for_every_other_port() {
        assert_eq!([(2, 0), (3, 2), (6, 1)].map(|(p, l)| bypass_limit(p, l)), [4, 5, 7]);
        assert_eq!(ONE.most_bypasses(), 5);
        assert_eq!(ONE.bound_by_gets(), Ticks(7));
        assert_eq!(Service { ahead: 1, longest: Ticks(3), ..ONE }.bound_by_gets(), Ticks(37));
    }

    #[test]
    fn a_message_is_refused_once_for_each_level_above_it() {
        assert_eq!([0, 1, 3].map(|rank| Service { rank, ..ONE }.most_refusals()), [1, 1, 3]);
        assert_eq!(Service { rank: 2, ..ONE }.bound(), Ticks(2 * 3 + 2 + 1));
        assert_eq!(Service { rank: 2, ahead: 3, penalty: Ticks(5), ..ONE }.bound(), Ticks(2 * 6 + 8 + 1));
        assert_eq!(Service { ahead: 1, rivals: 4, longest: Ticks(2), ..ONE }.bound(), Ticks(4 + 12 * 2 + 1));
    }

    #[test]
    fn nothing_overflows() {
        let far =
            Service { ahead: u16::MAX, rivals: u16::MAX, longest: Ticks::FAR, penalty: Ticks::FAR, ..ONE };
        assert_eq!((far.bound(), far.bound_by_gets()), (Ticks::FAR, Ticks::FAR));
    }
}
