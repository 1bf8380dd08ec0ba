//! The columns of the overview that the settings file can choose.

use std::str::FromStr;

/// The names of the columns after the first one, in the order of the cells of a row.
pub const NAMES: [&str; 10] =
    ["state", "queue", "slack", "rate", "expired", "overflow", "rejected", "resent", "timed_out", "health"];

/// A column after the first one: the index of its cell in a row of the overview.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OverviewColumn(usize);

impl OverviewColumn {
    /// The index of the column's cell; index 0 is the first column, which has the names.
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
