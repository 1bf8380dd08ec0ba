//! The checker's verdicts on the claims of the model. Each claim is checked only once per test program, even if several
//! tests use its verdict.

use imrs_model::{Options, Report, Silent, verify};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

/// The checker's report on a claim, with the bounds of a quick test run.
pub fn settled(claim: &'static str) -> Arc<Report> {
    static REPORTS: Mutex<BTreeMap<&str, Arc<OnceLock<Arc<Report>>>>> = Mutex::new(BTreeMap::new());
    // The map is not locked while a claim is checked, so that other claims can be checked at the same time.
    let report = Arc::clone(REPORTS.lock().expect("no panic").entry(claim).or_default());
    let settle = || {
        let options = Options { full: false, claim: Some(claim.into()), jobs: 1, memory: 4 << 30 };
        Arc::new(verify(&options, &Silent))
    };
    Arc::clone(report.get_or_init(settle))
}
