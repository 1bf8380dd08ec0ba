//! The validator's verdicts on the recorded inputs of nodes, by incarnation.

use super::{IncarnationId, Store};
pub use crate::conformance::{Conformance, Verdict};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The verdict on an incarnation. If there is none, the result says why.
#[must_use]
pub fn conformance(store: &Store, incarnation: IncarnationId) -> Conformance {
    let known = store.judged.get(&incarnation).map(|known| known.as_ref().clone());
    known.unwrap_or_else(|| Conformance::unknown("not recorded: start the node with --record"))
}

/// The verdicts so far, by incarnation.
pub(super) type Judged = BTreeMap<IncarnationId, Arc<Conformance>>;
