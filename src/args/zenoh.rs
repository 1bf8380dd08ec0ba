//! The options of `imrs zenoh`.

use clap::Args;
use std::path::PathBuf;

/// The arguments of `imrs zenoh`.
#[derive(Args, Clone, Debug)]
pub struct ZenohArgs {
    /// The cell file.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The node on this machine whose datagrams are carried.
    #[arg(long, value_name = "NAME")]
    pub node: String,
    /// The configuration of zenoh, in JSON5 or YAML: mode, endpoints, certificates [default: a peer that searches for
    /// others by multicast].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Also carry datagrams without keys: then any process that reaches the network of zenoh can forge them.
    #[arg(long)]
    pub insecure: bool,
}
