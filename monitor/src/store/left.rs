//! A remaining time as the monitor knows it.

use crate::clock::Span;
use std::fmt;

/// A remaining time, counted down since its sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Left {
    /// Microseconds; zero if it has probably ended.
    pub us: u64,
    /// Whether the sample is old, so that the value may be wrong.
    pub estimated: bool,
}

impl fmt::Display for Left {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.estimated { "~" } else { "" };
        f.pad(&format!("{mark}{}", Span::micros(self.us)))
    }
}
