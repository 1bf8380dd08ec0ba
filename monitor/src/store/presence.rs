//! Whether a node runs at a moment, and since when it does not.

use crate::clock::Span;
use std::fmt;
use std::time::Duration;

/// The presence of a node at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// The node sends frames.
    Up,
    /// The node is attached, but has sent nothing for this long.
    Silent(Duration),
    /// The node stopped in order, this long ago.
    Stopped(Duration),
    /// The node died, this long ago.
    Dead(Duration),
}

impl Presence {
    /// Whether the node is known to have ended.
    #[must_use]
    pub const fn is_gone(self) -> bool {
        matches!(self, Self::Stopped(_) | Self::Dead(_))
    }

    /// The presence and its length in two words: `DEAD 9s`.
    #[must_use]
    pub fn brief(self) -> String {
        match self {
            Self::Up => "up".to_owned(),
            Self::Silent(since) => format!("SILENT {}", Whole(since)),
            Self::Stopped(since) => format!("stopped {}", Whole(since)),
            Self::Dead(since) => format!("DEAD {}", Whole(since)),
        }
    }
}

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Up => f.write_str("up"),
            Self::Silent(since) => write!(f, "SILENT for {}", Whole(*since)),
            Self::Stopped(since) => write!(f, "stopped {} ago", Whole(*since)),
            Self::Dead(since) => write!(f, "DEAD {} ago", Whole(*since)),
        }
    }
}

/// A duration without fractions of a second.
struct Whole(Duration);

impl fmt::Display for Whole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.0.as_secs();
        if seconds < 60 {
            write!(f, "{seconds}s")
        } else {
            write!(f, "{}", Span(Duration::from_secs(seconds)))
        }
    }
}
