//! The transitions of a cell, as data that can be stored and replayed.

use serde::{Deserialize, Serialize};

/// A transition of a cell. Packets are positions in the state; nodes, tasks, directed links and faults are positions in the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CellMove {
    /// Time passes until the next event.
    Pass,
    /// Time passes until the next event, and the clock of this node counts one tick more (`true`) or less.
    Drift(u8, bool),
    /// A packet arrives at the end of its link.
    Deliver(u8),
    /// A packet is lost on its link.
    Lose(u8),
    /// A packet arrives, and a copy of it stays on the link.
    Duplicate(u8),
    /// The link of this packet is cut from here on, by the declared cut of this number.
    Cut(u8, u8),
    /// A packet is lost because its link is still cut.
    Vanish(u8),
    /// The declared cut of a link ends, and a packet arrives over that link: packet, cut.
    Mend(u8, u8),
    /// An action ends: task, activation, whether it succeeds, and which of its results it gives.
    Acted(u8, u8, bool, u8),
    /// An action does not end yet: task and activation.
    GoOn(u8, u8),
    /// An action takes this many ticks more: task, activation, ticks. Equals as many moves [`GoOn`](Self::GoOn) with
    /// [`Times::Every`](crate::cell::Times::Every).
    Takes(u8, u8, u32),
    /// The next packet of this link does not arrive yet.
    Stay(u8),
    /// A task of this node takes the input at this position.
    Take(u8, u8),
    /// On this node, the next of the scripts that are to begin in this tick begins.
    Begin(u8),
    /// A script makes this choice.
    Choose(u8, u16),
    /// The declared crash of this number happens.
    Crash(u8),
    /// A node restarts in its next incarnation.
    Restart(u8),
    /// The declared pause of this number begins at this node, before the node's next step.
    Pause(u8, u8),
    /// As [`Pause`](Self::Pause), but actions that the node began in this tick begin only when the node wakes.
    PauseBefore(u8, u8),
    /// Time passes as with [`Pass`](Self::Pass), and the declared pause of this number begins before this node notices the
    /// time.
    PauseNext(u8, u8),
    /// A node wakes from its pause.
    Wake(u8),
}

impl CellMove {
    /// Whether this move is a fault.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        match self {
            Self::Drift(..)
            | Self::Lose(_)
            | Self::Duplicate(_)
            | Self::Cut(..)
            | Self::Vanish(_)
            | Self::Acted(_, _, false, _)
            | Self::Crash(_)
            | Self::Pause(..)
            | Self::PauseBefore(..)
            | Self::PauseNext(..) => true,
            Self::Pass
            | Self::Deliver(_)
            | Self::Mend(..)
            | Self::Acted(_, _, true, _)
            | Self::GoOn(..)
            | Self::Takes(..)
            | Self::Stay(_)
            | Self::Take(..)
            | Self::Begin(_)
            | Self::Choose(..)
            | Self::Restart(_)
            | Self::Wake(_) => false,
        }
    }

    /// The packet that this move delivers or drops.
    #[must_use]
    pub const fn packet(self) -> Option<u8> {
        match self {
            Self::Deliver(i)
            | Self::Lose(i)
            | Self::Duplicate(i)
            | Self::Cut(i, _)
            | Self::Vanish(i)
            | Self::Mend(i, _) => Some(i),
            Self::Pass
            | Self::Drift(..)
            | Self::Acted(..)
            | Self::GoOn(..)
            | Self::Takes(..)
            | Self::Stay(_)
            | Self::Take(..)
            | Self::Begin(_)
            | Self::Choose(..)
            | Self::Crash(_)
            | Self::Restart(_)
            | Self::Pause(..)
            | Self::PauseBefore(..)
            | Self::PauseNext(..)
            | Self::Wake(_) => None,
        }
    }
}
