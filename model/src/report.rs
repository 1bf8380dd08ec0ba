//! Verdicts on the claims, in the form that the command prints and that JSON contains.

use crate::chart::Counterexample;
use serde::Serialize;

/// Whether a property holds in a state space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// The property holds in every state within the bounds.
    Holds,
    /// The search found a counterexample.
    Fails,
    /// A budget ended the search before a verdict.
    Unknown,
}

/// The bounds within which a claim was searched.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Bounds {
    /// How many packets may be lost.
    pub loss: u32,
    /// How many packets may arrive twice.
    pub dup: u32,
    /// The longest link delay, in ticks; absent: no time passes, and packets arrive in any order.
    pub delay: Option<u32>,
    /// How many crashes may happen.
    pub crash: u32,
    /// How many meetings each member tries, or how many messages are sent; absent: without limit.
    pub rounds: Option<u32>,
    /// The time_out, in ticks; absent: no member gives up.
    pub time_out: Option<u64>,
    /// The period of retransmissions, in ticks; absent: every packet is sent once.
    pub resend: Option<u64>,
    /// The margin, in ticks.
    pub margin: Option<u64>,
}

/// Numbers that a search found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Found {
    /// The fewest lost packets that strand a member (leave it waiting after all have arrived), if every packet is sent
    /// once.
    pub least_losses_to_strand: Option<u32>,
    /// The fewest lost packets that let a member give up although all have arrived, with retransmission.
    pub least_losses_with_resending: Option<u32>,
    /// The least margin that holds, in ticks: a margin one tick shorter fails.
    pub least_safe_margin: Option<u64>,
    /// The margin that the compiler uses for the same bounds (D56).
    pub closed_form_margin: Option<u64>,
    /// The TTL that the closed form gives (D59), in ticks.
    pub bound_ticks: Option<u64>,
    /// The least TTL that the search found to be enough, in ticks.
    pub least_bound_ticks: Option<u64>,
    /// The least number of attempts within which the members meet.
    pub attempts: Option<u32>,
}

impl Found {
    /// The search looked for no numbers.
    pub const NOTHING: Self = Self {
        least_losses_to_strand: None,
        least_losses_with_resending: None,
        least_safe_margin: None,
        closed_form_margin: None,
        bound_ticks: None,
        least_bound_ticks: None,
        attempts: None,
    };
}

/// The verdict on one claim under one rule.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The name of the claim.
    pub name: String,
    /// The rule variant: `default`, or what differs from it.
    pub rule: String,
    /// How many tasks take part.
    pub parties: u32,
    /// The claim in one sentence.
    pub about: String,
    /// The expected outcome.
    pub expect: Outcome,
    /// The result of the exploration.
    pub outcome: Outcome,
    /// Whether the outcome is the expected one, and every number that the search found has its pinned value.
    pub as_expected: bool,
    /// The bounds of the verdict.
    pub bounds: Bounds,
    /// The number of distinct states in all explorations for this verdict.
    pub states: u64,
    /// The number of transitions in all explorations for this verdict.
    pub transitions: u64,
    /// The depth of the state space: the length of the longest of the shortest paths to a state.
    pub depth: u32,
    /// Whether everything within the bounds was explored, or a counterexample found.
    pub complete: bool,
    /// The probability that two states share a fingerprint, so that one of them was not explored.
    pub collision_probability: f64,
    /// The number of bytes of the longest packed state.
    pub longest_state: u64,
    /// The duration in seconds of wall-clock time.
    pub seconds: f64,
    /// The number of distinct states explored per second.
    pub states_per_second: u64,
    /// Numbers that the search found.
    pub found: Found,
    /// A shortest counterexample.
    pub counterexample: Option<Counterexample>,
}

/// All verdicts of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The version of this JSON format.
    pub version: u32,
    /// The name of the cell file; absent if the protocol's own claims were checked.
    pub cell: Option<String>,
    /// The verdicts, in the order of the claims.
    pub claims: Vec<Verdict>,
}

impl Report {
    /// Whether every claim has its expected outcome.
    #[must_use]
    pub fn as_expected(&self) -> bool {
        self.claims.iter().all(|claim| claim.as_expected)
    }

    /// Whether a budget ended some exploration before its verdict.
    #[must_use]
    pub fn cut(&self) -> bool {
        self.claims.iter().any(|claim| !claim.complete)
    }
}

/// The probability that among `states` random 64-bit fingerprints two are equal.
#[must_use]
pub fn collision_probability(states: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "an estimate")]
    let n = states as f64;
    -(-n * n / 2.0_f64.powi(65)).exp_m1()
}
