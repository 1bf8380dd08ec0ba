//! Whether nodes do what the verified machine does (D63): what the validator says of the inputs that they record.

use super::{LifeId, Store};
use std::collections::BTreeMap;
use std::sync::Arc;

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

/// What is known of a life's conformance: at least why nothing is.
#[must_use]
pub fn conformance(store: &Store, life: LifeId) -> Conformance {
    let known = store.judged.get(&life).map(|known| known.as_ref().clone());
    known.unwrap_or_else(|| Conformance::unknown("not recorded: start the node with --record"))
}

/// What has been judged.
pub(super) type Judged = BTreeMap<LifeId, Arc<Conformance>>;
