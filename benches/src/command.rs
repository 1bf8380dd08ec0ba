//! The command line: which suites to measure, how many rounds, and where the output goes.

use crate::cases;
use crate::harness::{Results, measure};
use crate::machine::Facts;
use crate::report::{self, PageError};
use crate::suite::{Effort, Suite};
use crate::surroundings::Here;
use clap::{Args, ValueEnum};
use std::io::{self, IsTerminal};
use std::path::PathBuf;

/// The arguments of the measurements.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    /// The suites to measure [default: all]; `--list` names them.
    #[arg(value_name = "SUITE")]
    pub suites: Vec<String>,
    /// Measure only cases that have this text in their names; rows that need other cases are left out. May be given
    /// several times.
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// How often each case is measured, in turns with the other cases of its suite.
    #[arg(long, default_value_t = 7, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    pub rounds: u32,
    /// Measure with a tenth of the work and in three rounds: to see that everything runs, not to compare.
    #[arg(long)]
    pub quick: bool,
    /// List the suites and their cases, and measure nothing.
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

/// The forms of the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// Tables.
    Text,
    /// One JSON value.
    Json,
}

/// Whether all measured goals are met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All goals are met, or the user did not give `--gate`.
    Well,
    /// A goal is not met, and the user gave `--gate`.
    Missed,
}

/// Why nothing was measured, or the output was not written.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// There is no such suite.
    #[error("there is no suite `{name}`: {known}")]
    NoSuite {
        /// The name that the user gave.
        name: String,
        /// The names of the suites.
        known: String,
    },
    /// No case has this text in its name.
    #[error("no measurement has `{0}` in its name: `--list` names them all")]
    NoCase(String),
    /// The page with the table was not updated.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The picture of the rows was not written.
    #[error("cannot write {path}: {source}")]
    Picture {
        /// The path of the picture.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The output was not written.
    #[error("cannot write the answer: {0}")]
    Output(#[from] io::Error),
}

/// Measures the chosen suites, and passes the results of each suite to `say` as soon as it is measured.
///
/// # Errors
/// [`BenchError`], and the errors of `say`.
pub fn run<E: From<BenchError>>(
    args: &BenchArgs,
    say: &mut impl FnMut(&str) -> Result<(), E>,
) -> Result<Verdict, E> {
    let suites = chosen(args)?;
    if args.list {
        suites.iter().try_for_each(|suite| say(&list(suite)))?;
        return Ok(Verdict::Well);
    }
    let facts = Facts::now();
    if !facts.release {
        eprintln!("warning: built with debug assertions; the ratios are not those of a release build");
    }
    let (rounds, effort) = if args.quick { (3, Effort::Share(0.1)) } else { (args.rounds, Effort::FULL) };
    let text = args.format == Form::Text;
    if text {
        say(&format!("{}; {rounds} rounds\n", facts.line()))?;
    }
    let shows = io::stderr().is_terminal();
    let (mut all, mut here) = (Vec::new(), Here::now());
    for suite in suites {
        let results = measure(suite, rounds, effort, &mut here, |suite, round, case| {
            if shows {
                eprint!("\r\x1b[K{suite}, round {} of {rounds}: {case}", round + 1);
            }
        });
        if shows {
            eprint!("\r\x1b[K");
        }
        if text {
            let (cases, rows) = (report::cases(&results), report::rows(&results, args.slack));
            say(&format!("\n{}\n\n{cases}\n{rows}", results.suite))?;
        }
        all.push(results);
    }
    if args.format == Form::Json {
        say(&format!("{:#}\n", report::json(&facts, rounds, args.slack, &all)))?;
    }
    write_files(args, &facts, rounds, &all)?;
    let missed = all.iter().flat_map(|results| &results.rows).any(|row| row.met(args.slack) == Some(false));
    Ok(if args.gate && missed { Verdict::Missed } else { Verdict::Well })
}

fn write_files(args: &BenchArgs, facts: &Facts, rounds: u32, all: &[Results]) -> Result<(), BenchError> {
    if let Some(path) = &args.svg {
        let written = std::fs::write(path, report::plot(facts, args.slack, all));
        written.map_err(|source| BenchError::Picture { path: path.clone(), source })?;
    }
    if let Some(path) = &args.write {
        report::renew(path, facts, rounds, args.slack, all)?;
    }
    Ok(())
}

fn chosen(args: &BenchArgs) -> Result<Vec<Suite>, BenchError> {
    let all = cases::all();
    let names = &args.suites;
    let known: Vec<&str> = all.iter().map(|suite| suite.name).collect();
    if let Some(name) = names.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(BenchError::NoSuite { name: name.clone(), known: known.join(", ") });
    }
    let mut wanted = all;
    wanted.retain(|suite| names.is_empty() || names.iter().any(|name| name == suite.name));
    for suite in &mut wanted {
        suite
            .cases
            .retain(|case| args.only.is_empty() || args.only.iter().any(|text| case.name.contains(text)));
    }
    let measures = |text: &&String| {
        wanted.iter().flat_map(|suite| &suite.cases).any(|case| case.name.contains(text.as_str()))
    };
    if let Some(text) = args.only.iter().find(|text| !measures(text)) {
        return Err(BenchError::NoCase(text.clone()));
    }
    wanted.retain(|suite| !suite.cases.is_empty());
    Ok(wanted)
}

fn list(suite: &Suite) -> String {
    let cases = suite.cases.iter().map(|case| format!("  {}: {}\n", case.name, case.about));
    format!("{}\n{}", suite.name, cases.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        bench: BenchArgs,
    }

    fn said(args: &[&str]) -> Result<(Verdict, String), BenchError> {
        let args = Cli::parse_from([&["bench"], args].concat()).bench;
        let mut said = String::new();
        let verdict = run(&args, &mut |text: &str| {
            said += text;
            Ok::<(), BenchError>(())
        })?;
        Ok((verdict, said))
    }

    #[test]
    fn every_row_is_of_cases_that_this_build_may_have() {
        for suite in cases::all() {
            let mut names: Vec<&str> = suite.cases.iter().map(|case| case.name.as_str()).collect();
            for row in &suite.rows {
                assert!(names.contains(&row.subject.as_str()), "{}: {}", suite.name, row.subject);
                if let Some(name) = row.other() {
                    assert!(names.contains(&name), "{}: {name}", suite.name);
                }
            }
            let all = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), all, "{}: two cases of one name", suite.name);
        }
    }

    #[test]
    fn a_suite_that_is_not_there_is_named_with_those_that_are() {
        let error = said(&["quees"]).expect_err("no such suite").to_string();
        assert!(error.contains("`quees`") && error.contains("queues"), "{error}");
        let error = said(&["--only", "nosuch"]).expect_err("no such case").to_string();
        assert!(error.contains("`nosuch`") && error.contains("--list"), "{error}");
        let (_, listed) = said(&["--list", "queues"]).expect("a list");
        assert!(listed.starts_with("queues\n  machine/queue 16: "), "{listed}");
    }

    #[test]
    fn what_is_measured_is_told_as_a_table_and_as_json() {
        let quick = ["awake", "--quick", "--only", "machine/"];
        let (verdict, text) = said(&quick).expect("measured");
        assert_eq!(verdict, Verdict::Well);
        assert!(text.contains("machine/query : machine/ask"), "{text}");
        let (_, json) = said(&[&quick[..], &["--format", "json"]].concat()).expect("measured");
        let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        let rows = json["suites"][0]["rows"].as_array().expect("rows");
        let measured = |row: &&serde_json::Value| !row["ratio"].is_null();
        assert_eq!(rows.iter().filter(measured).count(), 1, "only one has both of its cases");
        assert_eq!(json["suites"][0]["cases"][0]["rounds"].as_array().map(Vec::len), Some(3));
    }
}
