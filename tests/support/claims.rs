//! The claims of the checker. Each is settled once, however many tests compare its verdicts with something.

use imrs_model::{Options, Report, Silent, verify};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

/// What the checker finds about a claim at the bounds of a quick run.
pub fn settled(claim: &'static str) -> Arc<Report> {
    static REPORTS: Mutex<BTreeMap<&str, Arc<OnceLock<Arc<Report>>>>> = Mutex::new(BTreeMap::new());
    // Claims are settled beside each other: the map is not locked meanwhile.
    let report = Arc::clone(REPORTS.lock().expect("no panic").entry(claim).or_default());
    let settle = || {
        let options = Options { full: false, claim: Some(claim.into()), jobs: 1, memory: 4 << 30 };
        Arc::new(verify(&options, &Silent))
    };
    Arc::clone(report.get_or_init(settle))
}
