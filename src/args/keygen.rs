//! The options of `imrs keygen`.

use clap::Args;
use std::path::PathBuf;

/// The arguments of `imrs keygen`.
#[derive(Args, Clone, Debug)]
pub struct KeygenArgs {
    /// The cell file.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The folder for the key files; created if it is missing [default: cell.keys beside cell.cell].
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Replace existing keys.
    #[arg(long)]
    pub force: bool,
}
