//! Checks the quick claims, or only those with a given name, until one has another verdict than expected, and prints
//! the name of that claim. For runs that try many versions of the protocol.
//!
//! `quick [CLAIM]`: the exit code is 0 if all claims have the expected verdict, 1 if one has not, 2 if no claim has
//! this name.

use imrs_model::{Options, Progress, Verdict, claim_names, verify};

/// Ends the process at the first claim with an unexpected verdict, because further claims do not matter.
struct UntilTheFirst;

impl Progress for UntilTheFirst {
    fn finished(&self, verdict: &Verdict) {
        if !verdict.as_expected {
            println!("{} ({}): {:?}", verdict.name, verdict.rule, verdict.outcome);
            std::process::exit(1);
        }
    }
}

fn main() {
    let claim = std::env::args().nth(1);
    if let Some(name) = claim.as_deref().filter(|name| !claim_names().contains(name)) {
        eprintln!("no claim is named {name}");
        std::process::exit(2);
    }
    let options = Options { full: false, claim, jobs: 2, memory: 4 << 30 };
    verify(&options, &UntilTheFirst);
}
