//! `imrs replay FILE... --cell CELL --model`: says whether a run is a path of the model that `imrs verify` explores.

use super::assumptions::Assumed;
use super::error::ReplayError;
use super::surroundings::{Surroundings, named};
use super::told::{ReplayAnswer, WALKS};
use super::{Opened, open};
use crate::args::{Format, ReplayArgs};
use crate::cell_file;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Output;
use crate::verify::{conduct, faults};
use imrs_language::{Unit, compile};
use imrs_launch::cells::{self, Loaded};
use imrs_launch::checks::{Change, Judge, ReplaySampler, Settlement};
use imrs_model::cell::{
    Budget, CellPlan, Conduct, Happened, Happening, Run, Steps, follow_run, steps_in_model,
};
use imrs_protocol::{CellTable, Incarnation, NodeId, TaskId};
use imrs_runtime::record::{Verdict, replay_scripts};
use imrs_runtime::script::Watch;
use imrs_wire::recording::{Ending, Header};
use std::path::Path;
use std::sync::Arc;

/// The replayed recordings of a run.
struct Recorded {
    /// The events of each task.
    tasks: Vec<Vec<Happening>>,
    whole: Vec<bool>,
    /// When the first task began, in microseconds of the clock that all nodes share.
    start: u64,
    /// The changes of the values that checks read.
    changes: Vec<Change>,
}

/// Follows a run through the model, and prints the result.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    let Some(path) = &args.cell else {
        return Err(Failure::Usage("name the cell that was run with --cell".into()));
    };
    let (_, loaded) = cells::open(path, args.paper)?;
    let plan = plan(path, args)?;
    let mut recorded = match read(args, &loaded)? {
        Ok(recorded) => recorded,
        Err(Unfollowed::Differs { task, how }) => {
            return tell(&ReplayAnswer::of_task(&loaded, task, how), path, args, out);
        }
        Err(Unfollowed::Gap(missing) | Unfollowed::Restarted(missing)) => {
            return tell(&ReplayAnswer::of_gap(&loaded, missing), path, args, out);
        }
    };
    let checks = judge(&loaded, &recorded);
    let around = Surroundings::of(&recorded.tasks, &recorded.whole, &loaded.table);
    end_where_nodes_stop(&mut recorded.tasks);
    let tick = loaded.table.cell().tick.0;
    let run = Run { tick, tasks: recorded.tasks, whole: recorded.whole };
    let mut plan = Arc::new(plan);
    let followed = follow_run(&plan, &run);
    Arc::make_mut(&mut plan).budget.seconds = WALKS.min(plan.budget.seconds);
    let steps = match followed.unexplained {
        Some(_) => Steps::default(),
        None => steps_in_model(&plan, &run),
    };
    let assumed = Assumed { loaded: &loaded, faults: &plan.faults, tick, start: recorded.start };
    let breaches = assumed.breaches(&around, &followed.late);
    let told = ReplayAnswer::new(&loaded, &followed, &steps, recorded.start, breaches, checks);
    tell(&told, path, args, out)
}

fn tell(told: &ReplayAnswer, path: &Path, args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
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

/// The plan with which `imrs verify` would explore the cell.
fn plan(path: &Path, args: &ReplayArgs) -> Result<CellPlan, Failure> {
    let compiled = compile(&cell_file::read(path)?);
    let tick_us = compiled.hir.as_ref().map_or(1, |hir| Unit::Ticks.usec(hir));
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
    plan.faults = lowered.faults.iter().map(|declared| faults(declared, &plan.table, tick_us)).collect();
    Ok(plan)
}

/// Why a run cannot be followed.
enum Unfollowed {
    /// The recording of a task differs from what its own state machine does.
    Differs { task: TaskId, how: String },
    /// Some inputs of the run are missing.
    Gap(String),
    /// A node was restarted. The model does not follow a node beyond its end.
    Restarted(String),
}

/// Replays all recordings of a run.
fn read(args: &ReplayArgs, loaded: &Loaded) -> Result<Result<Recorded, Unfollowed>, Failure> {
    let cell = loaded.table.cell();
    let mut tasks = vec![None; cell.tasks.len()];
    let mut whole = vec![true; cell.nodes.len()];
    let given = args.cell.as_deref().map(cell_file::shown);
    let sampler = Arc::new(ReplaySampler::new(loaded));
    let watch: Arc<dyn Watch> = Arc::clone(&sampler) as Arc<dyn Watch>;
    let mut changes = Vec::new();
    let mut incarnations: Vec<Vec<IncarnationRecording<'_>>> = vec![Vec::new(); cell.nodes.len()];
    let mut restarted: Vec<NodeId> = Vec::new();
    for path in &args.files {
        let Opened { mut reader, table, header, .. } =
            open(path, std::slice::from_ref(loaded), given.as_deref())?;
        let of_node = &mut incarnations[table.node.index()];
        if let Some(before) = of_node.iter().find(|one| one.incarnation == header.incarnation) {
            let node = &cell.nodes[table.node.index()].name;
            let (before, path) = (before.path.display(), path.display());
            return Err(Failure::Usage(format!("node {node} is given twice: {before} and {path}")));
        }
        let damaged = |source| ReplayError::Read { path: path.clone(), source };
        let replays = replay_scripts(&mut reader, &table, |task| loaded.program(task), Some(&watch));
        let replays = replays.map_err(damaged)?;
        let seen = sampler.changes();
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
            restarted.extend(happened.iter().filter_map(|happening| match happening.what {
                Happened::PeerRestarted(node) => Some(node),
                _ => None,
            }));
            tasks[task.index()] = Some(happened);
        }
        let Header { incarnation, restarted, .. } = header;
        of_node.push(IncarnationRecording { path, incarnation, restarted, span });
    }
    restarted.extend(incarnations_of_one_run(&mut incarnations)?);
    if let Some(missing) = tasks.iter().position(Option::is_none) {
        let node = &cell.nodes[cell.tasks[missing].node.index()].name;
        return Err(Failure::Usage(format!(
            "the recording of node `{node}` is missing: name the files of all"
        )));
    }
    let tasks: Vec<Vec<Happening>> = tasks.into_iter().flatten().collect();
    restarted.extend(spoke_before(&incarnations, &tasks, &loaded.table));
    if let Some(node) = restarted.iter().min().and_then(|node| cell.nodes.get(node.index())) {
        let why = format!(
            "node {} was restarted in it, and the model follows a node only up to its end; `imrs replay` without --model judges \
             each recording by itself",
            node.name
        );
        return Ok(Err(Unfollowed::Restarted(why)));
    }
    let start = tasks.iter().flatten().map(|happening| happening.at).min().unwrap_or(0);
    Ok(Ok(Recorded { tasks, whole, start, changes }))
}

/// The recording of one incarnation of a node.
#[derive(Clone)]
struct IncarnationRecording<'a> {
    path: &'a Path,
    incarnation: Incarnation,
    /// Whether the node had an earlier incarnation.
    restarted: bool,
    /// The interval that the recording covers; `None` if the recording is empty.
    span: Option<Span<'a>>,
}

impl IncarnationRecording<'_> {
    /// When the recording begins; an empty recording is sorted to the end.
    fn begins(&self) -> u64 {
        self.span.as_ref().map_or(u64::MAX, |span| span.first)
    }
}

/// Returns the nodes of which several recordings were given: one for each incarnation. Fails if the recordings cannot
/// be of one run.
fn incarnations_of_one_run(
    incarnations: &mut [Vec<IncarnationRecording<'_>>],
) -> Result<Vec<NodeId>, Failure> {
    let mut restarted = Vec::new();
    for (node, incarnations) in incarnations.iter_mut().enumerate() {
        incarnations.sort_by_key(|one| (one.restarted, one.begins()));
        for pair in incarnations.windows(2) {
            let [before, after] = pair else { continue };
            let overlap = before.span.as_ref().zip(after.span.as_ref());
            let overlap = overlap.is_some_and(|(before, after)| after.first <= before.last);
            if overlap || !after.restarted {
                return Err(of_two_runs(
                    before.span.as_ref(),
                    after.span.as_ref(),
                    (before.path, after.path),
                ));
            }
        }
        if incarnations.len() > 1 {
            restarted.push(NodeId::from_index(node));
        }
    }
    // In a cell with one node, no other node records anything while this node is dead, so a gap proves nothing.
    if incarnations.len() > 1 {
        of_one_run(incarnations.iter().flatten().filter_map(|one| one.span.clone()).collect())?;
    }
    Ok(restarted)
}

/// The nodes whose first recording is missing: other nodes received packets from them that were sent before their given
/// recordings begin.
fn spoke_before(
    incarnations: &[Vec<IncarnationRecording<'_>>],
    tasks: &[Vec<Happening>],
    table: &CellTable,
) -> Vec<NodeId> {
    let mut nodes = Vec::new();
    for (node, incarnations) in incarnations.iter().enumerate() {
        let node = NodeId::from_index(node);
        let Some(first) = incarnations.first().filter(|one| one.restarted).map(IncarnationRecording::begins)
        else {
            continue;
        };
        let early = |happening: &Happening| match &happening.what {
            Happened::Came(packet) => happening.at < first && table.location(packet.source) == Some(node),
            _ => false,
        };
        if tasks.iter().flatten().any(early) {
            nodes.push(node);
        }
    }
    nodes
}

/// The interval in which a recording was made, in microseconds of the boot-time clock that all nodes share.
#[derive(Clone)]
struct Span<'a> {
    path: &'a Path,
    first: u64,
    last: u64,
}

/// The longest gap in microseconds between two recordings of one run. The nodes of a run begin together, so a longer gap
/// means two runs.
const APART: u64 = 100_000;

/// Fails if a recording begins after all earlier ones have ended.
fn of_one_run(mut spans: Vec<Span<'_>>) -> Result<(), Failure> {
    spans.sort_by_key(|span| span.first);
    let Some((first, others)) = spans.split_first() else { return Ok(()) };
    let mut before = first;
    for span in others {
        if span.first > before.last.saturating_add(APART) {
            return Err(of_two_runs(Some(before), Some(span), (before.path, span.path)));
        }
        if span.last > before.last {
            before = span;
        }
    }
    Ok(())
}

fn of_two_runs(one: Option<&Span<'_>>, two: Option<&Span<'_>>, paths: (&Path, &Path)) -> Failure {
    let shown = |span: Option<&Span<'_>>, path: &Path| match span {
        Some(Span { first, last, .. }) => {
            let (first, last) = (*first as f64 / 1e6, *last as f64 / 1e6);
            format!("{} from {first:.3} s to {last:.3} s", path.display())
        }
        None => format!("{}, with nothing in it", path.display()),
    };
    let (one, two) = (shown(one, paths.0), shown(two, paths.1));
    Failure::Usage(format!("these are of two runs: {one}, {two} of the machine's clock"))
}

/// The verdicts on the checks of the run, up to the instant at which the nodes stopped, as the launcher judged them.
fn judge(loaded: &Loaded, recorded: &Recorded) -> Settlement {
    let nodes: Vec<NodeId> = (0..recorded.whole.len()).map(NodeId::from_index).collect();
    let (mut judge, mut over) = (Judge::new(loaded, &nodes), recorded.start);
    recorded.changes.iter().for_each(|change| judge.change(change.clone()));
    for node in nodes {
        // A node is unknown from its stop, or from its last record if it was killed. No recording shows when a node was
        // killed, and it may have acted after its last record. So a node never counts as dead here. If a check needs
        // the node's values for more than 1 s after that, its verdict is unknown here. The launcher, which knew of the
        // kill, gave a verdict (D142).
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

/// Ends the recorded run before two events that the model does not have. One is the arrival of a packet by which a
/// stopping node withdraws its tasks from their waits. The other is that a task learns that the node has stopped
/// whose answer it may wait for.
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
    let shows_an_end = |happening: &&Happening| match &happening.what {
        Happened::Came(packet) => taken_back.contains(&named(packet)),
        Happened::PeerStopped(_) => true,
        _ => false,
    };
    let end = tasks.iter().flatten().filter(shows_an_end).map(|happening| happening.at).min();
    if let Some(end) = end {
        tasks.iter_mut().for_each(|task| task.retain(|happening| happening.at < end));
    }
}
