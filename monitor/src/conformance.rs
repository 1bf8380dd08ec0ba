//! The validator's verdict: whether a node behaves like the verified state machine (D63).

/// The verdict on a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not known: the node does not record, or a part of its recording is missing.
    Unknown {
        /// The reason, as text.
        why: String,
    },
    /// Every step so far conforms to the state machine.
    Conforms,
    /// A step does not conform.
    Violates {
        /// The number of the step, counted from zero.
        step: u64,
        /// The difference from the state machine, as text.
        what: String,
    },
}

/// The conformance of one incarnation of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conformance {
    /// The validator's verdict.
    pub verdict: Verdict,
    /// How many steps the validator has checked.
    pub steps: u64,
}

impl Conformance {
    /// The verdict that the conformance is unknown, with its reason.
    #[must_use]
    pub fn unknown(why: &str) -> Self {
        Self { verdict: Verdict::Unknown { why: why.into() }, steps: 0 }
    }
}
