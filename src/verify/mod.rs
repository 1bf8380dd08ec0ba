//! `imrs verify`: asks the model checker for its verdicts and shows them.

mod cell;
mod progress;
mod report;

pub use cell::conduct;

use crate::args::{Format, VerifyArgs, VerifyVerb};
use crate::exit::{Exit, Failure, did_you_mean};
use crate::output::Output;
use imrs_model::{Options, Outcome, Report};
use progress::Lines;
use std::num::NonZero;
use std::thread;
use std::time::Instant;

/// The memory that a claim may take unless told otherwise.
const DEFAULT_MEMORY: u64 = 4 << 30;

/// Checks a cell, or without one the protocol's claims.
///
/// # Errors
/// [`Failure`].
pub fn run_verb(args: &VerifyVerb, out: &mut Output) -> Result<Exit, Failure> {
    match &args.cell {
        Some(path) => cell::run(path, args, out),
        None => run(&args.verify, out),
    }
}

/// Checks the protocol's claims.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &VerifyArgs, out: &mut Output) -> Result<Exit, Failure> {
    if let Some(claim) = &args.claim {
        let names = imrs_model::claim_names();
        if !names.contains(&claim.as_str()) {
            return Err(Failure::Usage(format!("no claim `{claim}`{}", did_you_mean(claim, names))));
        }
    }
    let options = Options {
        full: args.full,
        claim: args.claim.clone(),
        jobs: args.jobs.map_or_else(|| thread::available_parallelism().map_or(1, NonZero::get), usize::from),
        memory: args.memory.unwrap_or(DEFAULT_MEMORY),
    };
    let format = args.format.unwrap_or_default();
    let (started, lines) = (Instant::now(), Lines::new(format));
    let report = imrs_model::verify(&options, &lines);
    lines.clear();
    match format {
        Format::Json => out.json(&report)?,
        Format::Text => report::show(&report, args.claim.is_some(), started.elapsed(), out)?,
    }
    Ok(verdict(&report))
}

fn verdict(report: &Report) -> Exit {
    let cut_short = |v: &&imrs_model::Verdict| !v.as_expected && v.outcome == Outcome::Unknown;
    let unexpected = report.claims.iter().filter(|v| !v.as_expected).count();
    match (unexpected, report.claims.iter().filter(cut_short).count()) {
        (0, _) => Exit::Well,
        (all, cut) if all == cut => Exit::Budget,
        _ => Exit::Finding,
    }
}
