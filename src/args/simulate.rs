//! The options of `imrs simulate`.

use super::{Format, MOST_JOBS};
use clap::Args;
use std::path::PathBuf;

/// The arguments of `imrs simulate`.
#[derive(Args, Clone, Debug)]
pub struct SimulateArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Number of seeds to run [default: 1000; with --seed alone: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: Option<u64>,
    /// The first seed [default: taken from the clock, and named in the answer]. Without --seeds only this seed runs,
    /// and a run without findings is drawn as a chart.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Use the faults of this file in every run. If the file also has choices, as --save writes them, there is a single
    /// run.
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Shrink the findings of a file with choices, too.
    #[arg(long, requires = "plan")]
    pub shrink: bool,
    /// The most steps of a run.
    #[arg(long, value_name = "N", default_value_t = STEPS, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub steps: u32,
    /// Save the shrunk faults and choices of a finding, so that --plan can run them again.
    #[arg(long, value_name = "FILE")]
    pub save: Option<PathBuf>,
    /// Replace an existing file of --save.
    #[arg(long, requires = "save")]
    pub force: bool,
    /// Show the whole chart of this finding, counted from 1. With --save, save this finding.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub finding: u16,
    /// Allow only the keywords of the paper, and take its own rules.
    #[arg(long)]
    pub paper: bool,
    /// Number of threads: it does not change the answer [default: 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_JOBS))]
    pub jobs: Option<u16>,
    /// The form of the answer [default: text].
    #[arg(long, value_enum, value_name = "FORM")]
    pub format: Option<Format>,
}

/// The most steps of a run without `--steps`: with fewer, the longest run of examples/weld_cell.cell does not come to its end (D137).
pub const STEPS: u32 = 10_000;
