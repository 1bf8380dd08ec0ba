//! The outcomes of the rounds of a waitfor, as the summary shows them.

use super::spread::Spread;
use serde::Serialize;

/// Outcomes of all rounds of one waitfor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Rounds {
    /// Rounds that have ended.
    pub rounds: u64,
    /// Rounds in which all members were released.
    pub released: u64,
    /// Rounds in which no member was released: all waiting members gave up.
    pub timed_out: u64,
    /// Rounds in which some members were released and others gave up.
    pub divergent: u64,
    /// Rounds whose outcome is unknown: a killed node may have taken part, and its last messages are missing.
    pub unknown: u64,
    /// Rounds that had not ended when the run did; not counted in `rounds`.
    pub unfinished: u64,
    /// Releases in a round that not all members had announced.
    #[serde(skip)]
    pub false_releases: u64,
    /// The time between the first and the last member's start, in microseconds, over rounds that released all; `None` without
    /// any.
    pub start_skew_us: Option<Spread>,
}
