//! The options of `imrs keygen`.

use clap::Args;
use std::path::PathBuf;

/// What `keygen` can be asked.
#[derive(Args, Clone, Debug)]
pub struct KeygenArgs {
    /// The cell.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The folder for the files, made if it is missing.
    #[arg(long, value_name = "FOLDER", default_value = "keys")]
    pub out: PathBuf,
    /// Replace the keys that are there.
    #[arg(long)]
    pub force: bool,
}
