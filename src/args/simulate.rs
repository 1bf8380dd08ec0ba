//! What `imrs simulate` can be asked.

use super::{Format, MOST_JOBS};
use clap::Args;
use std::path::PathBuf;

/// What `simulate` can be asked.
#[derive(Args, Clone, Debug)]
pub struct SimulateArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Run so many seeds, one after another [default: 1000; with --seed alone: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: Option<u64>,
    /// Begin with this seed [default: from the clock, and said in the answer]. Without --seeds its run is drawn, too.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Take the faults from this file, and its choices where it has any: then it is one run.
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Shrink what the choices of that file show, too.
    #[arg(long, requires = "plan")]
    pub shrink: bool,
    /// End a run after so many steps.
    #[arg(long, value_name = "N", default_value_t = STEPS, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub steps: u32,
    /// Save the shrunk faults and choices of a finding for --plan.
    #[arg(long, value_name = "FILE")]
    pub save: Option<PathBuf>,
    /// Which finding is shown with its whole chart, and saved: counted from 1.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub finding: u16,
    /// Allow only the words of the paper, and take its own rules.
    #[arg(long)]
    pub paper: bool,
    /// Use so many threads: the answer is the same [default: 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_JOBS))]
    pub jobs: Option<u16>,
    /// The form of the answer [default: text].
    #[arg(long, value_enum, value_name = "FORM")]
    pub format: Option<Format>,
}

/// The most steps of a run unless told otherwise: with fewer the longest course of examples/weld_cell.cell is cut off (D137).
pub const STEPS: u32 = 10_000;
