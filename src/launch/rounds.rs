//! What came of the rounds of a waitfor.

use super::spread::Spread;
use serde::Serialize;

/// What came of all rounds of one waitfor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Rounds {
    /// Rounds that came to an end.
    pub rounds: u64,
    /// Of these, the rounds that released all members.
    pub released: u64,
    /// Rounds that released nobody: who was there gave up.
    pub timed_out: u64,
    /// Rounds that released some members and not others.
    pub divergent: u64,
    /// Rounds that a killed node took part in, or may have: its last words are missing.
    pub unknown: u64,
    /// Rounds that the end of the run cut short; not among `rounds`.
    pub unfinished: u64,
    /// Releases in a round that not all members had announced.
    #[serde(skip)]
    pub false_releases: u64,
    /// The time between the first and the last member's start, in microseconds, of the rounds that released all;
    /// `None` without any.
    pub start_skew_us: Option<Spread>,
}
