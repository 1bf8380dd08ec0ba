//! The outcomes of the rounds of a waitfor (a rendezvous of tasks), as the summary shows them.

use super::spread::Spread;
use imrs_protocol::Round;
use serde::Serialize;

/// The outcomes of all rounds of one waitfor (a rendezvous of tasks).
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

/// The round of a member's last event, extended across the wrap of [`Round`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Wide(i64);

impl Wide {
    /// Extends a round number: the result is the possible value that is nearest to the member's last round.
    pub fn count_on(&mut self, round: Round) -> i64 {
        let last = Round(self.0.rem_euclid(1 << 16) as u16);
        let (ahead, behind) = (round.steps_from(last), last.steps_from(round));
        self.0 += if ahead <= behind { i64::from(ahead) } else { -i64::from(behind) };
        self.0
    }
}
