//! The options of the verbs on runs: `imrs run`, `demo`, `replay`.

use super::Format;
use crate::demo::Scene;
use crate::faults::{ActionCommand, Cut, Kill, Rate, Restart};
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// What `demo` can be asked.
#[derive(Args, Clone, Debug)]
pub struct DemoArgs {
    /// Which cell.
    #[arg(value_enum, value_name = "NAME")]
    pub cell: Scene,
    /// Run without the demo's own fault; faults of your own take its place, too.
    #[arg(long)]
    pub no_fault: bool,
    /// How it is run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// What `run` can be asked.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// The cell.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the keywords of the paper, and run its own rules.
    #[arg(long)]
    pub paper: bool,
    /// Execute a command for an action; may be given several times.
    #[arg(long, value_name = "NAME=CMD")]
    pub action: Vec<ActionCommand>,
    /// How it is run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// How a cell is run.
#[derive(Args, Clone, Debug)]
pub struct LaunchArgs {
    /// Run all nodes in this process, joined without sockets.
    #[arg(long, conflicts_with = "node")]
    pub in_process: bool,
    /// Run this node only, at the address that the cell declares; the others run elsewhere.
    #[arg(long, value_name = "NAME")]
    pub node: Option<String>,
    /// Close the node's packets with its keys in this folder, made by `imrs keygen` [default: the folder beside the cell].
    #[arg(long, value_name = "FOLDER", requires = "node", conflicts_with = "insecure")]
    pub keys: Option<PathBuf>,
    /// Run without keys, though any process that reaches a node could forge its packets; all nodes must do the same.
    #[arg(long, conflicts_with = "in_process")]
    pub insecure: bool,
    /// Serve monitors over TCP, too; of several nodes each takes the next port.
    #[arg(long, value_name = "ADDR:PORT")]
    pub observe: Option<SocketAddr>,
    /// Over TCP show the nodes only to monitors that have the token in this file (16 to 256 bytes).
    #[arg(long, value_name = "FILE", requires = "observe")]
    pub observe_token: Option<PathBuf>,
    /// Serve monitors off the loopback though no token is asked for.
    #[arg(long, requires = "observe", conflicts_with = "observe_token")]
    pub observe_insecure: bool,
    /// Run the nodes under SCHED_FIFO, with their memory locked, each on one core.
    #[arg(long)]
    pub rt: bool,
    /// How long to run [default: a demo about 10s, a cell until its tasks end or Ctrl-C].
    #[arg(long = "for", value_name = "TIME", value_parser = crate::time::parse)]
    pub length: Option<Duration>,
    /// End the run when only tasks are left that serve for ever (`loop` without `exit`, or handlers only).
    #[arg(long)]
    pub until_idle: bool,
    /// Lose this share of all datagrams.
    #[arg(long, value_name = "RATE", default_value = "0%")]
    pub loss: Rate,
    /// Kill a node, or the node of a task, after a while.
    #[arg(long, value_name = "NAME@TIME")]
    pub kill: Vec<Kill>,
    /// Start a killed node again after a while (counted from the start), in its next incarnation.
    #[arg(long, value_name = "NAME@TIME")]
    pub restart: Vec<Restart>,
    /// Interrupt the link between two nodes after a while, for a while.
    #[arg(long, value_name = "A--B@TIME+TIME")]
    pub cut: Vec<Cut>,
    /// Record what goes into every communication task; each node writes a file of its own beside this name.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Replace what files of the recordings' names hold.
    #[arg(long, requires = "record")]
    pub force: bool,
    /// Seeds the lost packets and the lengths of the tasks' work [default: from the clock].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The form of the answer; JSON ends with one line, the summary.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `replay` can be asked.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// The recordings of nodes.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The cell that was run [default: the cell of a demo].
    #[arg(long, value_name = "CELL")]
    pub cell: Option<PathBuf>,
    /// It was run with `--paper`.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Say whether the whole run is a path of the model that `imrs verify` explores: takes the recordings of all nodes.
    #[arg(long, requires = "cell")]
    pub model: bool,
    /// Give up following the model after so long.
    #[arg(long, value_name = "TIME", requires = "model", default_value = "30s", value_parser = crate::time::parse)]
    pub within: Duration,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}
