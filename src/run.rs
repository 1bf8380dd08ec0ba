//! `imrs run`: a cell of the cell language on real nodes.

use crate::args::RunArgs;
use crate::cells;
use crate::exit::{Exit, Failure, did_you_mean};
use crate::launch::{self, Run};
use crate::output::Output;
use std::collections::BTreeMap;

/// Runs a cell.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (source, loaded) = cells::open(&args.cell, args.paper)?;
    if let Some(at) = loaded.scripts.iter().position(Option::is_none) {
        let task = &loaded.table.cell().tasks[at].name;
        return Err(Failure::Usage(format!(
            "task `{task}` is extern: a Rust program that links the runtime runs its node, not this command"
        )));
    }
    let mut actions = BTreeMap::new();
    for bound in &args.action {
        if !loaded.actions().any(|action| action == bound.name) {
            let hint = did_you_mean(&bound.name, loaded.actions());
            return Err(Failure::Usage(format!("the cell has no action `{}`{hint}", bound.name)));
        }
        actions.insert(bound.name.clone(), bound.words.clone());
    }
    let length = args.launch.length;
    let run = Run { source, loaded: &loaded, args: &args.launch, length, actions, introduction: None };
    launch::run(&run, out)
}
