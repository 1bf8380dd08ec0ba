//! The validator's verdict: whether a node behaves like the verified state machine (D63).

/// The verdict on a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not known: the node does not record, or a part of its recording is missing.
    Unknown {
        /// Why.
        why: String,
    },
    /// Every step so far conforms to the state machine.
    Conforms,
    /// A step does not conform.
    Violates {
        /// The step, counted from zero.
        step: u64,
        /// The difference.
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
    /// A verdict of unknown, with its reason.
    #[must_use]
    pub fn unknown(why: &str) -> Self {
        Self { verdict: Verdict::Unknown { why: why.into() }, steps: 0 }
    }
}
