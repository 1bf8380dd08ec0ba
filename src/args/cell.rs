//! The options of the verbs on the text of a cell: `imrs check`, `fmt`, `explain`, `graph`.

use super::Format;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// What `check` can be asked.
#[derive(Args, Clone, Debug)]
pub struct CheckArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the keywords of the paper, and look at its own rules.
    #[arg(long)]
    pub paper: bool,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `fmt` can be asked.
#[derive(Args, Clone, Debug)]
pub struct FmtArgs {
    /// The cell files; `-` is standard input, written to standard output.
    #[arg(value_name = "CELL", required = true)]
    pub cells: Vec<PathBuf>,
    /// Change nothing; say what would be changed.
    #[arg(long)]
    pub check: bool,
}

/// What `explain` can be asked.
#[derive(Args, Clone, Debug)]
pub struct ExplainArgs {
    /// The code [default: list them all].
    #[arg(value_name = "CODE")]
    pub code: Option<String>,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `graph` can be asked.
#[derive(Args, Clone, Debug)]
pub struct GraphArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The form of the picture.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Picture::Svg)]
    pub to: Picture,
}

/// The form of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Picture {
    /// For a browser.
    Svg,
    /// For Graphviz.
    Dot,
}
