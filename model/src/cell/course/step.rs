//! The steps of a cell.

use serde::{Deserialize, Serialize};

/// One thing that can happen next in a cell. Packets and links are positions in the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CellMove {
    /// Time passes until something happens.
    Pass,
    /// Time passes; this node counts one tick more or less.
    Drift(u8, bool),
    /// A packet arrives.
    Deliver(u8),
    /// It is lost.
    Lose(u8),
    /// It arrives, and will once more.
    Duplicate(u8),
    /// Its link is cut from here on: declared cut number so.
    Cut(u8, u8),
    /// Its link is still cut.
    Vanish(u8),
    /// Its link is no longer cut, and the packet arrives.
    Mend(u8, u8),
    /// An action ends: task, thread, whether well, and which of its values.
    Acted(u8, u8, bool, u8),
    /// An action does not end yet.
    GoOn(u8, u8),
    /// It takes so many ticks more: what as many [`GoOn`](Self::GoOn) come to where every tick counts.
    Takes(u8, u8, u32),
    /// What comes next on this link is still on its way.
    Stay(u8),
    /// A task of this node takes the input that waits in the node at this position.
    Take(u8, u8),
    /// The next of the scripts of this node begins that are to begin now.
    Begin(u8),
    /// A script gets its choice.
    Choose(u8, u16),
    /// Declared crash number so happens.
    Crash(u8),
    /// A node starts again.
    Restart(u8),
    /// Declared pause number so begins at this node, before what it would do next.
    Pause(u8, u8),
    /// The same; actions that it began in this tick begin when it goes on.
    PauseBefore(u8, u8),
    /// Time passes as with [`Pass`](Self::Pass); declared pause number so begins before this node notices.
    PauseNext(u8, u8),
    /// The node goes on after its pause.
    Wake(u8),
}

impl CellMove {
    /// Whether something goes wrong.
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

    /// The packet that it is about.
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
