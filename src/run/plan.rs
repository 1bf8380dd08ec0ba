//! Plans a run as the command line or a demo asks for it, and looks up the cell's nodes and tasks by their names.

use crate::args::{Format, LaunchArgs};
use crate::failure::Failure;
use crate::faults::{FaultError, Wanted, here, node, schedule};
use imrs_launch::cells::{Loaded, Source};
use imrs_launch::{Fault, Keys, Outcome, Run, Story};
use imrs_protocol::{Cell, NodeId, TaskId};
use std::collections::BTreeMap;
use std::time::Duration;

/// What a demo adds to a run.
#[derive(Clone, Copy, Debug)]
pub struct DemoPlan {
    /// The text that is printed before the run.
    pub introduction: &'static str,
    /// The fault that is injected; `None` if the demo injects none.
    pub moment: Option<&'static Moment>,
    /// Explains what happened, and says whether the promise was kept.
    pub explain: fn(&Story<'_>) -> Outcome,
}

/// A fault that is injected some time after a task has begun an action.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// The delay from the beginning of the action to the fault.
    pub after: Duration,
    /// The name of the task that runs the action.
    pub task: &'static str,
    /// The name of the task's action, as the cell writes it after `run`.
    pub action: &'static str,
    /// At which beginning of the action the fault is injected: 1 is the first.
    pub time: usize,
    /// The fault that is injected.
    pub fault: Planned,
    /// The text about the fault for the user.
    pub words: &'static str,
}

/// A fault that names nodes and tasks as the cell does.
#[derive(Clone, Copy, Debug)]
pub enum Planned {
    /// The link between two nodes is cut for this long.
    Cut([&'static str; 2], Duration),
    /// The node is killed.
    Kill(&'static str),
    /// The node is suspended (SIGSTOP) for this long. A node that shares its process with others is cut off from them
    /// instead.
    Pause(&'static str, Duration),
}

impl DemoPlan {
    /// The outcome of a finished run.
    pub fn outcome(&self, story: &Story<'_>) -> Outcome {
        let mut outcome = (self.explain)(story);
        if self.moment.is_some() && story.faults.is_empty() {
            outcome.words.push(
                "The fault never came: the run ended before its moment (--for gives more time).".into(),
            );
        }
        outcome
    }
}

/// Plans the run of a cell with these options, without the settings that depend on the machine. Checks that faults and
/// options fit the cell and each other.
///
/// # Errors
/// [`Failure::Fault`], [`Failure::Usage`].
pub fn plan<'a>(
    source: Source,
    loaded: &'a Loaded,
    args: &LaunchArgs,
    (length, only): (Option<Duration>, Option<NodeId>),
    demo: Option<DemoPlan>,
) -> Result<Run<'a>, Failure> {
    let cell = loaded.table.cell();
    let wanted = Wanted { kill: &args.kill, restart: &args.restart, cut: &args.cut };
    let faults = schedule(cell, length.unwrap_or(Duration::MAX), &wanted)?;
    if let Some(only) = only {
        here(cell, only, &faults)?;
    }
    if args.until_idle && !finishes(loaded, only) {
        return Err(Failure::Usage(
            "--until-idle: every task here serves for ever (`loop` without `exit`, or handlers only): end the run with --for or Ctrl-C".into(),
        ));
    }
    let moment = demo.and_then(|demo| demo.moment);
    Ok(Run {
        source,
        loaded,
        length,
        until_idle: args.until_idle,
        only,
        in_process: args.in_process,
        actions: BTreeMap::new(),
        ramps: Vec::new(),
        keys: if args.insecure { Keys::Checksums } else { Keys::Drawn },
        observe: args.observe,
        observe_token: None,
        rt: args.rt,
        rt_refused: false,
        seed: args.seed.unwrap_or_else(|| fastrand::u64(..1_000_000)),
        loss: args.loss.0,
        faults,
        moment: moment.map(|moment| moment.of(cell)).transpose()?.flatten(),
        record: args.record.clone(),
        force: args.force,
        has_lines: args.format == Format::Text,
        is_explained: demo.is_some(),
    })
}

/// Whether any task that this launcher runs can reach the end of its script.
fn finishes(loaded: &Loaded, only: Option<NodeId>) -> bool {
    let tasks = loaded.table.cell().tasks.iter().enumerate();
    let here = tasks.filter(|(_, task)| only.is_none_or(|only| task.node == only));
    here.map(|(at, _)| TaskId::from_index(at)).any(|task| loaded.can_finish(task))
}

impl Moment {
    /// Looks up the moment's task and nodes in a cell; `None` if the cell has no such task.
    fn of(&self, cell: &Cell) -> Result<Option<imrs_launch::Moment>, FaultError> {
        let task = cell.tasks.iter().position(|task| task.name == self.task).map(TaskId::from_index);
        let faults = match self.fault {
            Planned::Kill(name) => vec![(Duration::ZERO, Fault::Kill(node(cell, name)?))],
            Planned::Pause(name, length) => {
                let node = node(cell, name)?;
                vec![(Duration::ZERO, Fault::Pause(node)), (length, Fault::Resume(node))]
            }
            Planned::Cut([a, b], length) => {
                let (a, b) = (node(cell, a)?, node(cell, b)?);
                vec![(Duration::ZERO, Fault::Cut(a, b)), (length, Fault::Heal(a, b))]
            }
        };
        let (action, time, after) = (self.action.to_owned(), self.time, self.after);
        Ok(task.map(|task| imrs_launch::Moment { task, action, time, after, faults }))
    }
}
