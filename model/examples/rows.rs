//! Checks the claims at the large bounds. Prints the result of each row on standard error as soon as it ends, and at the
//! end prints the same report as `imrs verify --full --format json`.
//!
//! `rows [--quick] [CLAIM]`: `--quick` checks without the large bounds.

use imrs_model::{Options, Progress, Verdict, verify};
use std::time::Instant;

struct EachRow(Instant);

impl Progress for EachRow {
    fn started(&self, name: &str, rule: &str, parties: u32) {
        eprintln!("{:6.0} s: {name} ({rule}) of {parties}", self.0.elapsed().as_secs_f64());
    }

    fn finished(&self, verdict: &Verdict) {
        let word = if verdict.as_expected { "as expected" } else { "NOT AS EXPECTED" };
        eprintln!(
            "  {} ({}) of {}: {:?}, {word}; {} states of up to {} bytes, {:.1} s, {:?}",
            verdict.name,
            verdict.rule,
            verdict.parties,
            verdict.outcome,
            verdict.states,
            verdict.longest_state,
            verdict.seconds,
            verdict.found
        );
    }
}

fn main() -> Result<(), serde_json::Error> {
    let (flags, names): (Vec<_>, Vec<_>) = std::env::args().skip(1).partition(|word| word.starts_with("--"));
    let full = !flags.iter().any(|flag| flag == "--quick");
    let options = Options { full, claim: names.into_iter().next(), jobs: 2, memory: 4 << 30 };
    let report = verify(&options, &EachRow(Instant::now()));
    serde_json::to_writer(std::io::stdout(), &report)
}
