//! The options of the verbs on the text of a cell: `imrs check`, `fmt`, `explain`, `graph`.

use super::Format;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// The arguments of `imrs check`.
#[derive(Args, Clone, Debug)]
pub struct CheckArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the keywords of the paper, and apply the paper's own rules.
    #[arg(long)]
    pub paper: bool,
    /// Also estimate the traffic on each link, and say which tasks would cause less of it on another node.
    #[arg(long)]
    pub load: bool,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// The arguments of `imrs fmt`.
#[derive(Args, Clone, Debug)]
pub struct FmtArgs {
    /// The cell files. With `-` the text comes from standard input and goes to standard output.
    #[arg(value_name = "CELL", required = true)]
    pub cells: Vec<PathBuf>,
    /// Change nothing; show what would be changed.
    #[arg(long)]
    pub check: bool,
}

/// The arguments of `imrs explain`.
#[derive(Args, Clone, Debug)]
pub struct ExplainArgs {
    /// The code [default: list all codes].
    #[arg(value_name = "CODE")]
    pub code: Option<String>,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// The arguments of `imrs graph`.
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
    /// A picture for a browser.
    Svg,
    /// A text for Graphviz.
    Dot,
}
