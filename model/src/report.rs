//! Verdicts, as the command prints them and as JSON carries them.

use crate::chart::Counterexample;
use serde::Serialize;

/// Whether a property holds in a world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// In every state within the bounds.
    Holds,
    /// A counterexample was found.
    Fails,
    /// The budget ended first.
    Unknown,
}

/// The bounds of a verdict.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Bounds {
    /// Lost packets.
    pub loss: u32,
    /// Duplicated packets.
    pub dup: u32,
    /// The longest way of a packet, in ticks; absent where no time passes and packets arrive in any order.
    pub delay: Option<u32>,
    /// Crashes.
    pub crash: u32,
    /// Meetings each member tries, or messages sent; absent: without end.
    pub rounds: Option<u32>,
    /// The time_out, in ticks; absent: nobody gives up.
    pub time_out: Option<u64>,
    /// The period of re-sending, in ticks; absent: every packet is sent once.
    pub resend: Option<u64>,
    /// The margin, in ticks.
    pub margin: Option<u64>,
}

/// What a search found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Found {
    /// The least number of lost packets that strands a member, every packet sent once.
    pub least_losses_to_strand: Option<u32>,
    /// The same with re-sending.
    pub least_losses_with_resending: Option<u32>,
    /// The least margin that holds, in ticks: one less fails.
    pub least_safe_margin: Option<u64>,
    /// The margin the compiler uses for the same bounds (D56).
    pub closed_form_margin: Option<u64>,
    /// A bound that was searched for, in ticks.
    pub bound_ticks: Option<u64>,
    /// The least such bound that was found to be enough.
    pub least_bound_ticks: Option<u64>,
    /// The least number of attempts within which the members meet.
    pub attempts: Option<u32>,
}

impl Found {
    /// No number.
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

/// One claim under one rule.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The claim.
    pub name: String,
    /// The rule variant: `default`, or what differs from it.
    pub rule: String,
    /// How many tasks take part.
    pub parties: u32,
    /// One plain sentence.
    pub about: String,
    /// What should come out.
    pub expect: Outcome,
    /// What came out.
    pub outcome: Outcome,
    /// Whether the two agree, and what was searched for was found and is the number written down for it.
    pub as_expected: bool,
    /// Within which bounds.
    pub bounds: Bounds,
    /// Different states, over all explorations of this verdict.
    pub states: u64,
    /// Transitions, likewise.
    pub transitions: u64,
    /// The longest of the shortest ways to a state.
    pub depth: u32,
    /// Whether everything within the bounds was seen, or a counterexample found.
    pub complete: bool,
    /// How likely it is that two states share a fingerprint and one was not looked at.
    pub collision_probability: f64,
    /// The bytes of the longest state.
    pub longest_state: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Different states a second.
    pub states_per_second: u64,
    /// What a search found.
    pub found: Found,
    /// A shortest counterexample.
    pub counterexample: Option<Counterexample>,
}

/// All verdicts of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The version of this format.
    pub version: u32,
    /// The cell file; absent: the protocol's own claims.
    pub cell: Option<String>,
    /// The verdicts, in the order of the claims.
    pub claims: Vec<Verdict>,
}

impl Report {
    /// Whether every claim came out as it should.
    #[must_use]
    pub fn as_expected(&self) -> bool {
        self.claims.iter().all(|claim| claim.as_expected)
    }

    /// Whether a budget ended an exploration.
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
