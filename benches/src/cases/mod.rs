//! The cases that need no peer: floors written by hand, and what is to be measured.

pub mod cells;
pub mod floors;
pub mod handoff;

use crate::suite::Suite;

/// All suites, with the peers that this build has.
#[must_use]
pub fn all() -> Vec<Suite> {
    vec![handoff::awake(), handoff::threads()]
}
