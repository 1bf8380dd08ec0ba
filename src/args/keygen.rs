//! The options of `imrs keygen`.

use clap::Args;
use std::path::PathBuf;

/// What `keygen` can be asked.
#[derive(Args, Clone, Debug)]
pub struct KeygenArgs {
    /// The cell.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The folder for the files, made if it is missing [default: cell.keys beside cell.cell].
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Replace the keys that are there.
    #[arg(long)]
    pub force: bool,
}
