//! A remaining time as the monitor knows it.

use crate::clock::Span;
use std::fmt;

/// A remaining time, counted down from its sample to the present.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Left {
    /// The remaining time in microseconds; zero if it has probably ended.
    pub us: u64,
    /// Whether the sample is old, so that the remaining time may be wrong.
    pub estimated: bool,
}

impl fmt::Display for Left {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.estimated { "~" } else { "" };
        f.pad(&format!("{mark}{}", Span::micros(self.us)))
    }
}
