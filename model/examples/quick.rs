//! Settles the quick claims and names those that came out other than expected; the exit code says whether there are
//! any. For runs that try many versions of the protocol.

use imrs_model::{Options, Silent, verify};

fn main() {
    let options = Options { full: false, claim: None, jobs: 2, memory: 4 << 30 };
    let report = verify(&options, &Silent);
    for verdict in report.claims.iter().filter(|verdict| !verdict.as_expected) {
        println!("{} ({})", verdict.name, verdict.rule);
    }
    std::process::exit(i32::from(!report.as_expected()));
}
