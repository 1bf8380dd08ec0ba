//! The options of the verbs on runs: `imrs run`, `demo`, `replay`.

use super::Format;
use crate::demo::Scene;
use crate::faults::{ActionCommand, Cut, Kill, Rate, Restart};
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// The arguments of `imrs demo`.
#[derive(Args, Clone, Debug)]
pub struct DemoArgs {
    /// The demo to run.
    #[arg(value_enum, value_name = "NAME")]
    pub cell: Scene,
    /// Run without the demo's own fault. Faults that you give yourself replace the demo's fault, too.
    #[arg(long)]
    pub no_fault: bool,
    /// The options of the run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// The arguments of `imrs run`.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// The cell file.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the keywords of the paper, and run its own rules.
    #[arg(long)]
    pub paper: bool,
    /// Execute a command for an action; may be given several times.
    #[arg(long, value_name = "NAME=CMD")]
    pub action: Vec<ActionCommand>,
    /// The options of the run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// The options that `imrs run` and `imrs demo` share.
#[derive(Args, Clone, Debug)]
pub struct LaunchArgs {
    /// Run all nodes in this process, connected without sockets.
    #[arg(long, conflicts_with = "node")]
    pub in_process: bool,
    /// Run only this node, at the address that the cell declares for it; the other nodes run elsewhere.
    #[arg(long, value_name = "NAME")]
    pub node: Option<String>,
    /// Encrypt the node's packets with its keys in this folder, made by `imrs keygen` [default: the folder beside the
    /// cell].
    #[arg(long, value_name = "FOLDER", requires = "node", conflicts_with = "insecure")]
    pub keys: Option<PathBuf>,
    /// Run without keys: then any process that reaches a node can forge its packets. All nodes must do the same.
    #[arg(long, conflicts_with = "in_process")]
    pub insecure: bool,
    /// Also serve monitors over TCP, with --observe-token. If there are several nodes, each takes the next port.
    #[arg(long, value_name = "ADDR:PORT")]
    pub observe: Option<SocketAddr>,
    /// Over TCP, serve only monitors that have the token in this file (16 to 256 bytes).
    #[arg(long, value_name = "FILE", requires = "observe")]
    pub observe_token: Option<PathBuf>,
    /// Over TCP, serve all who reach the address, without a token.
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
    /// Interrupt the link between two nodes after a while, for a given time.
    #[arg(long, value_name = "A--B@TIME+TIME")]
    pub cut: Vec<Cut>,
    /// Record the inputs of every communication task. Each node writes a file of its own, whose name is made from this
    /// name.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Write what this node reports into a file, at the end of the run. `imrs summary` makes one summary from the files of
    /// all machines.
    #[arg(long, value_name = "FILE", requires = "node", conflicts_with_all = ["kill", "restart"])]
    pub report: Option<PathBuf>,
    /// Replace existing files that have the names of the recordings or of the report.
    #[arg(long)]
    pub force: bool,
    /// The seed of the lost packets and of the times of simulated actions [default: from the clock].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The form of the answer; in JSON the last line is the summary.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// The arguments of `imrs summary`.
#[derive(Args, Clone, Debug)]
pub struct SummaryArgs {
    /// The cell file that the machines ran.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The reports of the machines.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The machines ran the cell with `--paper`.
    #[arg(long)]
    pub paper: bool,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// The arguments of `imrs replay`.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// The recordings of nodes.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The file of the cell that was run [default: the cells of the demos].
    #[arg(long, value_name = "CELL")]
    pub cell: Option<PathBuf>,
    /// The cell was run with `--paper`.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Say whether the whole run is a path of the model that `imrs verify` explores. Needs the recordings of all nodes.
    #[arg(long, requires = "cell")]
    pub model: bool,
    /// The longest time for which the run is followed through the model.
    #[arg(long, value_name = "TIME", requires = "model", default_value = "30s", value_parser = crate::time::parse)]
    pub within: Duration,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}
