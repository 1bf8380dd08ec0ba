use imrs_model::{Options, Silent, verify};
fn main() {
    let name = std::env::args().nth(1);
    let full = std::env::args().nth(2).is_some();
    let report = verify(&Options { full, claim: name, jobs: 2, memory: 4 << 30 }, &Silent);
    for v in &report.claims {
        println!(
            "{:5} {:28} {:34} {:?} found {:?} states {} {:.1}s longest {} complete {}",
            v.as_expected,
            v.name,
            v.rule,
            v.outcome,
            v.found,
            v.states,
            v.seconds,
            v.longest_state,
            v.complete
        );
        if !v.as_expected {
            if let Some(c) = &v.counterexample {
                println!("{c:#?}");
            }
        }
    }
}
