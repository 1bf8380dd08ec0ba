//! The verdicts on the checker's claims. Each claim is checked once, however many tests use its verdicts.

use imrs_model::{Options, Report, Silent, verify};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

/// The checker's report on a claim, at the bounds of a quick run.
pub fn settled(claim: &'static str) -> Arc<Report> {
    static REPORTS: Mutex<BTreeMap<&str, Arc<OnceLock<Arc<Report>>>>> = Mutex::new(BTreeMap::new());
    // The map is not locked during a check, so that several claims can be checked at once.
    let report = Arc::clone(REPORTS.lock().expect("no panic").entry(claim).or_default());
    let settle = || {
        let options = Options { full: false, claim: Some(claim.into()), jobs: 1, memory: 4 << 30 };
        Arc::new(verify(&options, &Silent))
    };
    Arc::clone(report.get_or_init(settle))
}
