//! The options of `imrs unit`.

use clap::Args;
use std::path::PathBuf;

/// The arguments of `imrs unit`.
#[derive(Args, Clone, Debug)]
pub struct UnitArgs {
    /// The cell file.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The node that the unit runs.
    #[arg(long, value_name = "NAME")]
    pub node: String,
    /// The user who runs the node, and who owns its keys.
    #[arg(long, value_name = "NAME", default_value = "imrs")]
    pub user: String,
    /// Options of `imrs run`. Relative paths in them begin at the folder of the cell.
    #[arg(last = true, value_name = "OPTION", allow_hyphen_values = true)]
    pub options: Vec<String>,
}
