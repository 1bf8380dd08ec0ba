//! The columns of the overview that the settings file can choose.

use std::str::FromStr;

/// The names of the columns beside the first, in the order of the cells of a row.
pub const NAMES: [&str; 10] =
    ["state", "queue", "slack", "rate", "expired", "overflow", "rejected", "resent", "timed_out", "health"];

/// A column beside the names: the index of its cell in a row of the overview.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OverviewColumn(usize);

impl OverviewColumn {
    /// The index of its cell; the names have 0.
    #[must_use]
    pub const fn cell(self) -> usize {
        self.0
    }
}

impl FromStr for OverviewColumn {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let at = NAMES.iter().position(|name| *name == text);
        at.map(|at| Self(at + 1)).ok_or_else(|| crate::name::unknown("column", text, &NAMES))
    }
}
