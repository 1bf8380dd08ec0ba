//! `imrs run`: runs a cell of the cell language on real nodes.

mod drive;
mod lines;
mod plan;
mod report;

pub use drive::run as launch;
pub use plan::{DemoPlan, Moment, Planned, plan};

use crate::args::{LaunchArgs, RunArgs};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::names::did_you_mean;
use crate::output::Output;
use imrs_client::place;
use imrs_launch::cells::{self, Loaded};
use imrs_launch::{LaunchError, Run, record_file};
use imrs_protocol::NodeId;
use imrs_wire::files;
use std::collections::BTreeMap;
use std::env;
use std::net::SocketAddr;
use std::path::Path;

/// Runs a cell.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (source, loaded) = cells::open(&args.cell, args.paper)?;
    let only = chosen(&loaded, &args.launch)?;
    let mut actions = BTreeMap::new();
    for bound in &args.action {
        if !loaded.actions().any(|action| action == bound.name) {
            let hint = did_you_mean(&bound.name, loaded.actions());
            return Err(Failure::Usage(format!("the cell has no action `{}`{hint}", bound.name)));
        }
        if let Some(program) = bound.words.first().filter(|program| !is_there(program)) {
            return Err(Failure::Usage(format!(
                "--action {}: there is no program `{program}`: give its path, or put its folder into PATH",
                bound.name
            )));
        }
        actions.insert(bound.name.clone(), bound.words.clone());
    }
    let args = &args.launch;
    let run = plan(source, &loaded, args, (args.length, only), None)?;
    launch(Run { actions, ..run }, args, None, out)
}

/// Whether the program of a command can be found, by the same rules as when it is executed.
fn is_there(program: &str) -> bool {
    if Path::new(program).components().count() > 1 {
        return Path::new(program).is_file();
    }
    let folders = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&folders).any(|folder| folder.join(program).is_file())
}

/// The only node that runs here, if `--node` names one. Also checks that the options fit the cell and each other.
///
/// # Errors
/// [`Failure::Usage`].
pub fn chosen(loaded: &Loaded, args: &LaunchArgs) -> Result<Option<NodeId>, Failure> {
    let nodes = &loaded.table.cell().nodes;
    let position = |name: &String| {
        let found = nodes.iter().position(|node| node.name == *name).map(NodeId::from_index);
        let hint = || did_you_mean(name, nodes.iter().map(|node| node.name.as_str()));
        found.ok_or_else(|| Failure::Usage(format!("the cell has no node `{name}`{}", hint())))
    };
    if args.length.is_some_and(|length| length.is_zero()) {
        return Err(Failure::Usage("--for 0s: nothing would run".into()));
    }
    let only = args.node.as_ref().map(position).transpose()?;
    for (at, task) in loaded.table.cell().tasks.iter().enumerate() {
        if loaded.scripts[at].is_none() && only.is_none_or(|only| only == task.node) {
            let node = &nodes[task.node.index()].name;
            return Err(Failure::Usage(format!(
                "task `{}` is extern: a Rust program says what it does. Write one that links `imrs-client` (examples/extern_task.rs) and let it run node `{node}`; run the others here with --node",
                task.name
            )));
        }
    }
    let secure = |address: SocketAddr| args.insecure || args.keys.is_some() || address.ip().is_loopback();
    let asks = args.observe_token.is_some() || args.observe_insecure;
    if let Some(address) = args.observe.filter(|address| !asks && !address.ip().is_loopback()) {
        return Err(Failure::Usage(format!(
            "--observe {address}: any machine that reaches this address could watch the nodes, because no token is asked for. Add --observe-token FILE and give the monitor the same file (imrs monitor --connect tcp:{address} --token FILE), take a loopback address (an ssh tunnel leads there), or add --observe-insecure"
        )));
    }
    if let Some(only) = only {
        let address = place::address(loaded, only).map_err(LaunchError::from)?;
        if !secure(address) {
            return Err(Failure::Usage(format!(
                "node `{}` at {address}: nothing authenticates its packets, so any machine that reaches this address could forge them. Make keys (imrs keygen CELL --out FOLDER), copy to each machine the file of its node, and add --keys FOLDER; or, on a network of your own, add --insecure",
                nodes[only.index()].name
            )));
        }
    }
    recordings_are_free(loaded, only, args)?;
    Ok(only)
}

/// Refuses to replace recordings of an earlier run without `--force`. This changes nothing: a node replaces its file only
/// once it is bound and locked, so that a run that never begins destroys no recording.
fn recordings_are_free(loaded: &Loaded, only: Option<NodeId>, args: &LaunchArgs) -> Result<(), Failure> {
    let Some(file) = &args.record else { return Ok(()) };
    let nodes = loaded.table.cell().nodes.iter().enumerate();
    for (_, node) in nodes.filter(|(at, _)| only.is_none_or(|only| only.index() == *at)) {
        // A restarted node writes its next incarnation into another file beside the first.
        let later = (2..=args.restart.len() + 1).map(|number| format!("{}-{number}", node.name));
        for name in std::iter::once(node.name.clone()).chain(later) {
            let path = record_file(file, &name);
            let refused = |error| Failure::Usage(format!("--record {}: {error}", path.display()));
            files::check(&path, args.force).map_err(refused)?;
        }
    }
    Ok(())
}
