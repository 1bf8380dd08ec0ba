//! `imrs verify`: runs the model checker and shows its verdicts.

mod advice;
mod answer;
mod cell;
mod covered;
mod happens;
mod limits;
mod progress;
mod report;
mod save;
mod search_lines;
mod subject;
mod tell;

pub use answer::{FindingAnswer, NotChecked, Place, Rounded};
pub use subject::{Subject, conduct, faults};
pub use tell::{chart, quoted};

use crate::args::{Format, VerifyArgs, VerifyVerb};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::names::did_you_mean;
use crate::output::Output;
use imrs_model::{Explorer, ExplorerError, Limits, Options, Outcome, Report, compared};
use progress::Lines;
use std::net::SocketAddr;
use std::num::NonZero;
use std::thread;
use std::time::Instant;

/// The memory limit of a check if the user gives no `--memory`, in bytes.
const DEFAULT_MEMORY: u64 = 4 << 30;

/// How often each kind of fused step is compared at least while all claims are checked.
const LEAST_COMPARED: u64 = 1_000;

/// Checks a cell if one was named, else the protocol's claims.
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
    if let (Some(address), Some(claim)) = (args.explore, &args.claim) {
        return explore(claim, address, args, out);
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
    match compared().rarest() {
        (kind, times) if args.claim.is_none() && times < LEAST_COMPARED => {
            Err(Failure::TooFewCompared { kind, times })
        }
        _ => Ok(verdict(&report)),
    }
}

/// Serves the state space of a claim over HTTP until the process is ended.
fn explore(claim: &str, address: SocketAddr, args: &VerifyArgs, out: &mut Output) -> Result<Exit, Failure> {
    let refused = |error: ExplorerError| Failure::Usage(format!("{claim}: {error}"));
    let explorer = Explorer::of_claim(claim).map_err(refused)?;
    let limits = Limits { memory: args.memory.unwrap_or(DEFAULT_MEMORY), ..Limits::default() };
    let mut said = Ok(());
    explorer
        .serve(address, limits, |address| said = out.line(format!("{claim}: http://{address}/ until Ctrl-C")))
        .map_err(refused)?;
    said?;
    Ok(Exit::Well)
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
