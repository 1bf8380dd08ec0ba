//! `imrs run`: runs a cell of the cell language on real nodes.

mod drive;
mod lines;
mod plan;
pub mod report;
mod service;

pub use drive::run as launch;
pub use plan::{DemoPlan, Moment, Planned, plan};

use crate::args::{LaunchArgs, RunArgs};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::names::did_you_mean;
use crate::output::Output;
use imrs_client::{cell_file, keys, place};
use imrs_launch::cells::{self, Loaded, Source};
use imrs_launch::{Keys, LaunchError, Run, record_file};
use imrs_protocol::{NodeId, TaskId};
use imrs_wire::files;
use std::collections::BTreeMap;
use std::env;
use std::path::{Path, PathBuf};

/// Runs a cell until the run ends.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (source, loaded) = cells::open(&args.cell, args.paper)?;
    launch(checked(args, source, &loaded)?, &args.launch, None, out)
}

/// The run that the options ask for. Checks that they fit the cell, each other and this machine; starts nothing.
///
/// # Errors
/// [`Failure`].
pub fn checked<'a>(args: &RunArgs, source: Source, loaded: &'a Loaded) -> Result<Run<'a>, Failure> {
    let only = chosen(loaded, &args.launch)?;
    let mut actions = BTreeMap::new();
    for bound in &args.action {
        if !loaded.actions().any(|action| action == bound.name) {
            let hint = did_you_mean(&bound.name, loaded.actions());
            return Err(Failure::Usage(format!("the cell has no action `{}`{hint}", bound.name)));
        }
        runs_here(loaded, only, &bound.name)?;
        if let Some(program) = bound.words.first().filter(|program| !is_there(program)) {
            return Err(Failure::Usage(format!(
                "--action {}: there is no program `{program}`: give its path, or put its folder into PATH",
                bound.name
            )));
        }
        actions.insert(bound.name.clone(), bound.words.clone());
    }
    let (cell, args) = (&args.cell, &args.launch);
    let mut run = plan(source, loaded, args, (args.length, only), None)?;
    if let Some(name) = args.node.as_ref().filter(|_| !args.insecure) {
        run.keys = Keys::Folder(folder_of_keys(cell, args, name)?);
    }
    Ok(Run { actions, ..run })
}

/// Refuses a command for an action that no task of the only node here runs: it would never be executed.
fn runs_here(loaded: &Loaded, only: Option<NodeId>, action: &str) -> Result<(), Failure> {
    let cell = loaded.table.cell();
    let Some(only) = only else { return Ok(()) };
    let node_of = |task: TaskId| cell.tasks[task.index()].node;
    if loaded.tasks_with_action(action).any(|task| node_of(task) == only) {
        return Ok(());
    }
    let there = loaded.tasks_with_action(action).map(|task| {
        format!(
            "task `{}` on node `{}`",
            cell.tasks[task.index()].name,
            cell.nodes[node_of(task).index()].name
        )
    });
    Err(Failure::Usage(format!(
        "--action {action}: node `{}` runs no task with this action, but {} does: give --action where that node is started",
        cell.nodes[only.index()].name,
        there.collect::<Vec<_>>().join(", ")
    )))
}

/// The folder with the keys of a node that runs on its own: the folder that the user named, else the one beside the
/// cell file.
fn folder_of_keys(cell: &Path, args: &LaunchArgs, node: &str) -> Result<PathBuf, Failure> {
    let beside = || Some(keys::beside(cell)).filter(|beside| !cell_file::is_stdin(cell) && beside.is_dir());
    args.keys.clone().or_else(beside).ok_or_else(|| {
        let cell = cell_file::shown(cell);
        Failure::Usage(format!(
            "node `{node}` has no keys, and without them other processes could forge its packets. Type `imrs keygen {cell}` once, and start the nodes again; on another machine, name a folder with the file of its node: --keys FOLDER. On a network of your own, --insecure on all nodes does without keys"
        ))
    })
}

/// Whether the program of a command can be found, by the rules that apply when it is executed.
fn is_there(program: &str) -> bool {
    if Path::new(program).components().count() > 1 {
        return Path::new(program).is_file();
    }
    let folders = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&folders).any(|folder| folder.join(program).is_file())
}

/// The only node that this launcher runs, if `--node` names one. Also checks that the options fit the cell and each other.
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
    let asks = args.observe_token.is_some() || args.observe_insecure;
    if let Some(address) = args.observe.filter(|_| !asks) {
        return Err(Failure::Usage(format!(
            "--observe {address}: all who reach this address could watch the nodes, on a loopback address each user of this machine, because no token is asked for. Add --observe-token FILE and give the monitor the same file (imrs monitor --connect tcp:{address} --token FILE), or add --observe-insecure. For a monitor of your own on this machine leave --observe out: `imrs monitor` finds the nodes"
        )));
    }
    if let Some(only) = only {
        place::address(loaded, only).map_err(LaunchError::from)?;
    }
    if let Some(report) = &args.report {
        kept::check(report, args.force)?;
    }
    recordings_are_free(loaded, only, args)?;
    Ok(only)
}

/// Refuses to replace recordings of an earlier run without `--force`. This changes nothing: a node replaces its file
/// only once it has bound its socket and locked its incarnation, so that a run that never begins destroys no recording.
fn recordings_are_free(loaded: &Loaded, only: Option<NodeId>, args: &LaunchArgs) -> Result<(), Failure> {
    let Some(file) = &args.record else { return Ok(()) };
    let nodes = loaded.table.cell().nodes.iter().enumerate();
    for (_, node) in nodes.filter(|(at, _)| only.is_none_or(|only| only.index() == *at)) {
        // A restarted node records its next incarnation in another file, beside the first one.
        let later = (2..=args.restart.len() + 1).map(|number| format!("{}-{number}", node.name));
        for name in std::iter::once(node.name.clone()).chain(later) {
            let path = record_file(file, &name);
            let refused = |error| Failure::Usage(format!("--record {}: {error}", path.display()));
            files::check(&path, args.force).map_err(refused)?;
        }
    }
    Ok(())
}
