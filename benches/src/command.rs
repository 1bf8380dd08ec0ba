//! The command line: which suites, how many rounds, where the answer goes.

use crate::cases;
use crate::harness::{Results, measure};
use crate::machine::Facts;
use crate::report::{self, PageError};
use crate::suite::{Effort, Suite};
use clap::{Args, ValueEnum};
use std::io::{self, Write};
use std::path::PathBuf;

/// What to measure.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    /// The suites to measure [default: all]; `--list` names them.
    #[arg(value_name = "SUITE")]
    pub suites: Vec<String>,
    /// How often each case is measured, in turns with the others of its suite.
    #[arg(long, default_value_t = 7, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    pub rounds: u32,
    /// A tenth of the work a round, and three rounds: to see that it runs, not to compare.
    #[arg(long)]
    pub quick: bool,
    /// Name the suites and their cases, and measure nothing.
    #[arg(long)]
    pub list: bool,
    /// The form of the answer.
    #[arg(long, value_enum, default_value_t = Form::Text, value_name = "FORM")]
    pub format: Form,
    /// Draw the rows as a picture.
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Renew the table between the marks of a page.
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// By how much a ratio may miss its bound.
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR")]
    pub slack: f64,
    /// End with 1 where a goal is not met.
    #[arg(long)]
    pub gate: bool,
}

/// The forms of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// Tables.
    Text,
    /// One JSON value.
    Json,
}

/// Whether every goal that was measured is met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All of them, or nobody asked.
    Well,
    /// Not all, and `--gate` asked.
    Missed,
}

/// Why nothing was measured, or the answer did not get where it should.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// There is no such suite.
    #[error("there is no suite `{name}`: {known}")]
    NoSuite {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// The page was not renewed.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The picture was not written.
    #[error("cannot write {path}: {source}")]
    Picture {
        /// The picture.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The answer was not written.
    #[error("cannot write the answer: {0}")]
    Output(#[from] io::Error),
}

/// Measures what was asked for.
///
/// # Errors
/// [`BenchError`].
pub fn run(args: &BenchArgs, out: &mut impl Write) -> Result<Verdict, BenchError> {
    let suites = chosen(&args.suites)?;
    if args.list {
        list(&suites, out)?;
        return Ok(Verdict::Well);
    }
    let facts = Facts::now();
    if !facts.release {
        eprintln!("warning: built with debug assertions; the ratios are not those of a release build");
    }
    let (rounds, effort) = if args.quick { (3, Effort(0.1)) } else { (args.rounds, Effort(1.0)) };
    let text = args.format == Form::Text;
    if text {
        writeln!(out, "{}; {rounds} rounds\n", facts.line())?;
    }
    let mut all = Vec::new();
    for suite in suites {
        let results = measure(suite, rounds, effort, |suite, round, case| {
            eprint!("\r\x1b[K{suite}, round {} of {rounds}: {case}", round + 1);
        });
        eprint!("\r\x1b[K");
        if text {
            let (cases, rows) = (report::cases(&results), report::rows(&results, args.slack));
            writeln!(out, "{}\n\n{cases}\n{rows}", results.suite)?;
        }
        all.push(results);
    }
    hand_over(args, &facts, rounds, &all, out)?;
    let missed = all.iter().flat_map(|results| &results.rows).any(|row| row.met(args.slack) == Some(false));
    Ok(if args.gate && missed { Verdict::Missed } else { Verdict::Well })
}

fn hand_over(
    args: &BenchArgs,
    facts: &Facts,
    rounds: u32,
    all: &[Results],
    out: &mut impl Write,
) -> Result<(), BenchError> {
    if args.format == Form::Json {
        let json = report::json(facts, rounds, args.slack, all);
        writeln!(out, "{json:#}")?;
    }
    if let Some(path) = &args.svg {
        let written = std::fs::write(path, report::plot(facts, args.slack, all));
        written.map_err(|source| BenchError::Picture { path: path.clone(), source })?;
    }
    if let Some(path) = &args.write {
        report::renew(path, facts, rounds, args.slack, all)?;
    }
    Ok(())
}

fn chosen(names: &[String]) -> Result<Vec<Suite>, BenchError> {
    let known: Vec<&str> = cases::all().iter().map(|suite| suite.name).collect();
    if let Some(name) = names.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(BenchError::NoSuite { name: name.clone(), known: known.join(", ") });
    }
    let wanted = |suite: &Suite| names.is_empty() || names.iter().any(|name| name == suite.name);
    Ok(cases::all().into_iter().filter(wanted).collect())
}

fn list(suites: &[Suite], out: &mut impl Write) -> io::Result<()> {
    for suite in suites {
        writeln!(out, "{}", suite.name)?;
        for case in &suite.cases {
            writeln!(out, "  {}: {}", case.name, case.about)?;
        }
    }
    Ok(())
}
