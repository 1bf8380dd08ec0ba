//! Whether nodes do what the verified machine does (D63): what the validator says of the inputs that they record.

use super::{LifeId, Store};
pub use crate::conformance::{Conformance, Verdict};
use std::collections::BTreeMap;
use std::sync::Arc;

/// What is known of a life's conformance: at least why nothing is.
#[must_use]
pub fn conformance(store: &Store, life: LifeId) -> Conformance {
    let known = store.judged.get(&life).map(|known| known.as_ref().clone());
    known.unwrap_or_else(|| Conformance::unknown("not recorded: start the node with --record"))
}

/// What has been judged.
pub(super) type Judged = BTreeMap<LifeId, Arc<Conformance>>;
