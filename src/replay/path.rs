//! `imrs replay FILE... --cell CELL --model`: is this run a path of the model that `imrs verify` explores?

use super::assumptions::Assumed;
use super::surroundings::{Surroundings, named};
use super::told::Told;
use super::{Opened, ReplayError, open};
use crate::args::{Format, ReplayArgs};
use crate::cell_file;
use crate::cells::{self, Loaded};
use crate::checks::{Change, Judge, Looker, Settlement};
use crate::exit::{Exit, Failure};
use crate::output::Output;
use crate::verify::{conduct, faults};
use imrs_language::{Compiled, Unit, compile};
use imrs_model::cell::{
    Budget, CellPlan, Conduct, Happened, Happening, Run, Steps, follow_run, steps_in_model,
};
use imrs_protocol::{CellTable, NodeId, TaskId};
use imrs_runtime::record::{Verdict, replay_scripts};
use imrs_runtime::script::Watch;
use imrs_wire::recording::Ending;
use std::path::Path;
use std::sync::Arc;

/// How many seconds the steps of a run are looked for where `imrs verify` looks.
pub const WALKS: f64 = 5.0;

/// What was recorded of a run.
struct Recorded {
    /// For each task, what happened.
    tasks: Vec<Vec<Happening>>,
    whole: Vec<bool>,
    /// When the first task began.
    start: u64,
    /// What checks ask of the tasks, by their nodes.
    changes: Vec<Change>,
}

/// Follows a run.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    let Some(path) = &args.cell else {
        return Err(Failure::Usage("say with --cell which cell was run".into()));
    };
    let (_, loaded) = cells::open(path, args.paper)?;
    let (mut searched, plan) = plans(path, args)?;
    let mut recorded = match read(args, &loaded)? {
        Ok(recorded) => recorded,
        Err(Unfollowed::Differs { task, how }) => {
            return tell(&Told::of_task(&loaded, task, how), path, args, out);
        }
        Err(Unfollowed::Gap(missing)) => return tell(&Told::of_gap(&loaded, missing), path, args, out),
    };
    let checks = judge(&loaded, &recorded);
    let around = Surroundings::of(&recorded.tasks, &recorded.whole, &loaded.table);
    let faults = searched.faults.clone();
    end_where_nodes_stop(&mut recorded.tasks);
    let tick = loaded.table.cell().tick.0;
    let run = Run { tick, tasks: recorded.tasks, whole: recorded.whole };
    let followed = follow_run(&Arc::new(plan), &run);
    searched.budget.seconds = WALKS.min(searched.budget.seconds);
    let steps = match followed.unexplained {
        Some(_) => Steps::default(),
        None => steps_in_model(&Arc::new(searched), &run),
    };
    let assumed = Assumed { loaded: &loaded, faults: &faults, tick, start: recorded.start };
    let breaches = assumed.breaches(&around, &followed.late);
    let told = Told::new(&loaded, &followed, &steps, recorded.start, breaches, checks);
    tell(&told, path, args, out)
}

fn tell(told: &Told, path: &Path, args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    match args.format {
        Format::Json => out.json(told)?,
        Format::Text => {
            let files: Vec<String> = args.files.iter().map(|file| file.display().to_string()).collect();
            told.show(&cell_file::shown(path), out)?;
            out.line(format!("  recorded in {}", files.join(", ")))?;
        }
    }
    Ok(told.verdict())
}

/// The cell as `imrs verify` explores it, and the same without its `model tick`, which is for searches only.
fn plans(path: &Path, args: &ReplayArgs) -> Result<(CellPlan, CellPlan), Failure> {
    let mut compiled = compile(&cell_file::read(path)?);
    let searched = plan(&compiled, args)?;
    if let Some(hir) = &mut compiled.hir {
        hir.model_tick = None;
    }
    Ok((searched, plan(&compiled, args)?))
}

fn plan(compiled: &Compiled, args: &ReplayArgs) -> Result<CellPlan, Failure> {
    let lowered = compiled.lower(Unit::Ticks);
    let lowered = lowered.ok_or_else(|| Failure::Usage("the cell has errors: see `imrs check`".into()))?;
    let table = CellTable::new(lowered.cell).map(Arc::new).map_err(|errors| {
        let all: Vec<String> = errors.iter().map(ToString::to_string).collect();
        Failure::Usage(format!("in whole ticks the cell does not fit: {}", all.join("; ")))
    })?;
    let tasks: Vec<Conduct> = lowered.tasks.iter().map(conduct).collect();
    if let Some(at) = tasks.iter().position(|task| matches!(task, Conduct::Extern(_))) {
        let name = &table.cell().tasks[at].name;
        return Err(Failure::Usage(format!("what the extern task `{name}` did is not in the model")));
    }
    let mut plan = CellPlan::new(table, tasks);
    plan.budget = Budget { seconds: args.within.as_secs_f64(), ..plan.budget };
    plan.faults = lowered.faults.iter().map(faults).collect();
    Ok(plan)
}

/// Why a run is not followed.
enum Unfollowed {
    /// The recording of a task is not even what its own machine does.
    Differs { task: TaskId, how: String },
    /// Inputs are missing.
    Gap(String),
}

/// Replays all recordings of a run.
fn read(args: &ReplayArgs, loaded: &Loaded) -> Result<Result<Recorded, Unfollowed>, Failure> {
    let cell = loaded.table.cell();
    let mut tasks = vec![None; cell.tasks.len()];
    let mut whole = vec![true; cell.nodes.len()];
    let given = args.cell.as_deref().map(cell_file::shown);
    let looker = Arc::new(Looker::new(loaded));
    let watch: Arc<dyn Watch> = Arc::clone(&looker) as Arc<dyn Watch>;
    let mut changes = Vec::new();
    let mut of_node: Vec<Option<&Path>> = vec![None; cell.nodes.len()];
    let mut spans = Vec::new();
    for path in &args.files {
        let Opened { mut reader, table, .. } = open(path, std::slice::from_ref(loaded), given.as_deref())?;
        if let Some(before) = of_node[table.node.index()].replace(path) {
            let node = &cell.nodes[table.node.index()].name;
            let (before, path) = (before.display(), path.display());
            return Err(Failure::Usage(format!("node {node} is given twice: {before} and {path}")));
        }
        let damaged = |source| ReplayError::Read { path: path.clone(), source };
        let replays = replay_scripts(&mut reader, &table, |task| loaded.program(task), Some(&watch));
        let replays = replays.map_err(damaged)?;
        let seen = looker.changes();
        whole[table.node.index()] = reader.ending() == Ending::Ended;
        let mut span: Option<Span<'_>> = None;
        for replay in replays {
            let task = replay.task();
            let name = &cell.tasks[task.index()].name;
            match replay.verdict() {
                Verdict::Same => {}
                Verdict::Unknown => {
                    let missing = format!("inputs of `{name}` are missing in {}", path.display());
                    return Ok(Err(Unfollowed::Gap(missing)));
                }
                verdict @ (Verdict::Differs(_)
                | Verdict::ScriptDiffers(_)
                | Verdict::Breaks(_)
                | Verdict::Miscounts(_)) => {
                    let how = super::divergence(verdict, name).unwrap_or_default();
                    return Ok(Err(Unfollowed::Differs { task, how }));
                }
            }
            let of_task = seen.iter().filter(|change| change.task == task).cloned();
            let base = replay.base().unwrap_or_default();
            changes.extend(of_task.map(|change| Change { at: base.saturating_add(change.at), ..change }));
            let happened = replay.happened().unwrap_or_default();
            for at in happened.iter().map(|happening| happening.at) {
                let span = span.get_or_insert(Span { path, first: at, last: at });
                (span.first, span.last) = (span.first.min(at), span.last.max(at));
            }
            tasks[task.index()] = Some(happened);
        }
        spans.extend(span);
    }
    of_one_run(spans)?;
    if let Some(missing) = tasks.iter().position(Option::is_none) {
        let node = &cell.nodes[cell.tasks[missing].node.index()].name;
        return Err(Failure::Usage(format!(
            "the recording of node `{node}` is missing: name the files of all"
        )));
    }
    let tasks: Vec<Vec<Happening>> = tasks.into_iter().flatten().collect();
    let start = tasks.iter().flatten().map(|happening| happening.at).min().unwrap_or(0);
    Ok(Ok(Recorded { tasks, whole, start, changes }))
}

/// When a recording was made, in microseconds of the monotonic clock.
struct Span<'a> {
    path: &'a Path,
    first: u64,
    last: u64,
}

/// So many microseconds may lie between the ends of what one node did and the beginning of what another did: the nodes
/// of a run begin together.
const APART: u64 = 100_000;

/// No recording may begin after all that began before it had ended.
fn of_one_run(mut spans: Vec<Span<'_>>) -> Result<(), Failure> {
    spans.sort_by_key(|span| span.first);
    let Some((first, others)) = spans.split_first() else { return Ok(()) };
    let mut before = first;
    for span in others {
        if span.first > before.last.saturating_add(APART) {
            let shown = |span: &Span<'_>| {
                let (first, last) = (span.first as f64 / 1e6, span.last as f64 / 1e6);
                format!("{} from {first:.3} s to {last:.3} s", span.path.display())
            };
            return Err(Failure::Usage(format!(
                "these are of two runs: {}, {} of the machine's clock",
                shown(before),
                shown(span)
            )));
        }
        if span.last > before.last {
            before = span;
        }
    }
    Ok(())
}

/// What came of the checks, as the run itself judged them: up to where its nodes stopped.
fn judge(loaded: &Loaded, recorded: &Recorded) -> Settlement {
    let nodes: Vec<NodeId> = (0..recorded.whole.len()).map(NodeId::from_index).collect();
    let (mut judge, mut over) = (Judge::new(loaded, &nodes), recorded.start);
    recorded.changes.iter().for_each(|change| judge.change(change.clone()));
    for node in nodes {
        // From when it stopped nothing is known of a node; of one that was killed, from its last record.
        let tasks = loaded.table.tasks_on(node).map(|task| &recorded.tasks[task.index()]);
        let all: Vec<&Happening> = tasks.flatten().collect();
        let stop = all.iter().find(|happening| happening.what == Happened::Stopped);
        let last = stop.or_else(|| all.iter().max_by_key(|happening| happening.at));
        if let Some(last) = last.map(|happening| happening.at) {
            judge.told(node, last);
            over = over.max(last);
        }
        judge.gone(node);
    }
    judge.over(over);
    judge.all_told();
    judge.settle();
    judge.settlement(recorded.start)
}

/// A node that stops takes back what its tasks wait in, which no model does: the run ends before anybody hears of that.
fn end_where_nodes_stop(tasks: &mut [Vec<Happening>]) {
    let mut taken_back = Vec::new();
    for task in tasks.iter() {
        let stopped = task.iter().position(|happening| happening.what == Happened::Stopped);
        let after = task.iter().skip(stopped.unwrap_or(task.len()));
        taken_back.extend(after.filter_map(|happening| match &happening.what {
            Happened::Sent(packet) => Some(named(packet)),
            _ => None,
        }));
    }
    let heard = |happening: &&Happening| matches!(&happening.what, Happened::Came(packet) if taken_back.contains(&named(packet)));
    let end = tasks.iter().flatten().filter(heard).map(|happening| happening.at).min();
    if let Some(end) = end {
        tasks.iter_mut().for_each(|task| task.retain(|happening| happening.at < end));
    }
}
