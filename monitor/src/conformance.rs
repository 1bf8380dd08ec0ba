//! Whether a node does what the verified machine does (D63), as the validator says it.

/// What is known of a node's conformance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing: it does not record, or a part of its recording is missing.
    Unknown {
        /// Why.
        why: String,
    },
    /// Every step so far was what the machine does.
    Conforms,
    /// A step was not.
    Violates {
        /// Which, counted from zero.
        step: u64,
        /// What differed.
        what: String,
    },
}

/// The conformance of one life of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conformance {
    /// What the validator says.
    pub verdict: Verdict,
    /// How many steps it has judged.
    pub steps: u64,
}

impl Conformance {
    /// Nothing is known, because of `why`.
    #[must_use]
    pub fn unknown(why: &str) -> Self {
        Self { verdict: Verdict::Unknown { why: why.into() }, steps: 0 }
    }
}
