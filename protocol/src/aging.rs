//! The longest time that a message waits for service, in closed form (D58, D59).
//!
//! The declaration of a task bounds how often GETs bypass the first message of a port, and how often rank rejects an
//! offered message. This number times the longest service bounds the wait: a message with a longer TTL is served. The model
//! checker searches for the least TTL that is served and shows it beside the closed form, which must never be smaller.

use crate::ticks::Ticks;

/// The inputs of the bound: the receiving task, the port, and the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Service {
    /// The number of the receiving task's ports, including those that it sends on.
    pub ports: u16,
    /// The number of entries in the task's `order`.
    pub levels: u8,
    /// The rank of the message: how many entries of the `order` rank above it. Only for ports with a handler.
    pub rank: u8,
    /// How many messages may be ahead of the message in its own port: at most `bounded_buffer - 1` if all have the same TTL.
    pub ahead: u16,
    /// How many earlier rejected messages may wait in other ports with a handler: the sum of the `bounded_buffer`s of
    /// those ports whose messages can be rejected. Only for ports with a handler.
    pub rivals: u16,
    /// The longest time from one GET to the next. For ports with a handler: the longest time that the task or a handler
    /// runs without a wait, a statement boundary or a return.
    pub longest: Ticks,
    /// The time penalty of the port; the cell's tick if it declares none. Only for ports with a handler.
    pub penalty: Ticks,
}

/// How many times other ports are served although this port has a message, before this port is served first (D58).
#[must_use]
pub const fn bypass_limit(ports: u16, levels: u8) -> u16 {
    let each = ports.saturating_add(levels as u16);
    if each > 4 { each } else { 4 }
}

impl Service {
    /// How often GETs over all ports can bypass the first message of a port. Once the port has reached its limit, every
    /// other port may still be served before it once more, because its message may have waited longer.
    #[must_use]
    pub const fn most_bypasses(&self) -> u16 {
        bypass_limit(self.ports, self.levels).saturating_add(self.ports.saturating_sub(1))
    }

    /// How often a message can be rejected by rank, while no handler waits, before it outranks the task's own thread.
    #[must_use]
    pub const fn most_refusals(&self) -> u8 {
        if self.rank == 0 { 1 } else { self.rank }
    }

    /// A sufficient TTL for a message of a port without a handler, served by GETs over all ports.
    ///
    /// The message, and each one ahead of it, is taken after at most [`most_bypasses`](Self::most_bypasses) others.
    /// The service that runs when the message arrives ends first.
    #[must_use]
    pub fn bound_by_gets(&self) -> Ticks {
        let gets = (u64::from(self.most_bypasses()) + 1).saturating_mul(u64::from(self.ahead) + 1);
        Ticks(gets.saturating_mul(self.longest.0)) + Ticks(1)
    }

    /// A sufficient TTL for a message of a port with a handler. It assumes that handlers do not wait, and that the message
    /// outranks the task's own thread only once it is capped, because no rank lies between the first rank and the rank of
    /// `self` (D76).
    ///
    /// The message is rejected at most [`most_refusals`](Self::most_refusals) times. It is offered again each time when
    /// the penalty is over and the task can be interrupted. Then all earlier rejected messages of any port go before
    /// it. Before each of those messages, and before this one, one message may go that outranks the thread by itself.
    #[must_use]
    pub fn bound(&self) -> Ticks {
        let refusals = u64::from(self.most_refusals());
        let refused = refusals.saturating_mul(self.penalty.0.saturating_add(self.longest.0));
        let before = u64::from(self.ahead) + u64::from(self.rivals);
        // The first 1 is the service that runs when the message comes; the last 1 is the message that may go before this
        // one.
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
