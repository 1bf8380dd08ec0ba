//! The outcomes of the rounds of a waitfor, as the summary shows them.

use super::spread::Spread;
use serde::Serialize;

/// The outcomes of all rounds of one waitfor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Rounds {
    /// How many rounds have ended.
    pub rounds: u64,
    /// In how many rounds all members were released.
    pub released: u64,
    /// In how many rounds no member was released: all waiting members gave up.
    pub timed_out: u64,
    /// In how many rounds some members were released and others gave up.
    pub divergent: u64,
    /// How many rounds have an unknown outcome: a killed node may have taken part, and its last messages are missing.
    pub unknown: u64,
    /// How many rounds had not ended when the run did; they are not counted in `rounds`.
    pub unfinished: u64,
    /// How many members were released in a round that not all members had announced.
    #[serde(skip)]
    pub false_releases: u64,
    /// The time between the starts of the first and the last member, in microseconds, over all rounds that released all
    /// members; `None` if there was no such round.
    pub start_skew_us: Option<Spread>,
}
