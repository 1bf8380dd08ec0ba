//! `imrs replay FILE... --cell CELL --model`: is this run a path of the model that `imrs verify` explores?

use super::{Opened, ReplayError, open};
use crate::args::{Format, ReplayArgs};
use crate::cell_file;
use crate::cells::{self, Loaded};
use crate::exit::{Exit, Failure};
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count};
use crate::verify::conduct;
use imrs_language::hir::Faults;
use imrs_language::{Compiled, Unit, compile};
use imrs_model::cell::{
    Budget, CellFaults, CellPlan, Conduct, Followed, Happened, Happening, Run, Steps, Turn, Unexplained,
    follow_run, steps_in_model,
};
use imrs_protocol::{CellTable, NodeId, Packet, TaskId, Ticks};
use imrs_runtime::record::{self, Verdict, replay_scripts};
use imrs_wire::recording::Ending;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// How many seconds the steps of a run are looked for where `imrs verify` looks.
const WALKS: f64 = 5.0;

/// What was recorded of a run.
struct Recorded {
    /// For each task, what happened.
    tasks: Vec<Vec<Happening>>,
    whole: Vec<bool>,
    /// When the first task began.
    start: u64,
}

/// Follows a run.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, out: &mut Output) -> Result<Exit, Failure> {
    let Some(path) = &args.cell else {
        return Err(Failure::Usage("say with --cell which cell was run".into()));
    };
    let (_, loaded) = cells::open(path)?;
    let (mut searched, plan) = plans(path, args)?;
    let mut recorded = match read(args, &loaded)? {
        Ok(recorded) => recorded,
        Err(differs) => return told_apart(&differs, &loaded, args, out),
    };
    let breaches = breaches(&recorded.tasks, &loaded.table);
    end_where_nodes_stop(&mut recorded.tasks);
    let tick = loaded.table.cell().tick.0;
    let run = Run { tick, tasks: recorded.tasks, whole: recorded.whole };
    let followed = follow_run(&Arc::new(plan), &run);
    searched.budget.seconds = WALKS.min(searched.budget.seconds);
    let steps = steps_in_model(&Arc::new(searched), &run);
    let told = Told::new(&loaded, &followed, &steps, (breaches, recorded.start));
    match args.format {
        Format::Json => out.json(&told)?,
        Format::Text => told.show(&cell_file::shown(path), out)?,
    }
    Ok(match (told.unexplained.is_some(), told.complete) {
        (true, _) => Exit::Finding,
        (false, false) => Exit::Budget,
        (false, true) => Exit::Well,
    })
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
    let Faults { loss, dup, fail, drift, .. } = lowered.faults;
    plan.faults = CellFaults { loss, dup, fail, drift, crash: lowered.faults.crash, cut: lowered.faults.cut };
    Ok(plan)
}

/// A task whose recording is not even what its own machine does.
struct Differs {
    task: TaskId,
    how: String,
}

fn told_apart(
    differs: &Differs,
    loaded: &Loaded,
    args: &ReplayArgs,
    out: &mut Output,
) -> Result<Exit, Failure> {
    let cell = loaded.table.cell();
    let task = &cell.tasks[differs.task.index()];
    let at = Where {
        node: cell.nodes[task.node.index()].name.clone(),
        task: task.name.clone(),
        line: None,
        seconds: 0.0,
        why: differs.how.clone(),
    };
    let told = Told { cell: cell.name.clone(), complete: true, unexplained: Some(at), ..Told::default() };
    match args.format {
        Format::Json => out.json(&told)?,
        Format::Text => {
            let text = format!(
                "`{}` did something else than its own state machine does: {}",
                task.name, differs.how
            );
            out.line(Styled(BAD, text))?;
        }
    }
    Ok(Exit::Finding)
}

/// Replays all recordings of a run.
fn read(args: &ReplayArgs, loaded: &Loaded) -> Result<Result<Recorded, Differs>, Failure> {
    let cell = loaded.table.cell();
    let mut tasks = vec![None; cell.tasks.len()];
    let mut whole = vec![true; cell.nodes.len()];
    for path in &args.files {
        let Opened { mut reader, table, .. } = open(path, loaded)?;
        let damaged = |source| ReplayError::Read { path: path.clone(), source };
        let replays = replay_scripts(&mut reader, &table, |task| loaded.program(task)).map_err(damaged)?;
        whole[table.node.index()] = reader.ending() == Ending::Ended;
        for replay in replays {
            let task = replay.task();
            let name = &cell.tasks[task.index()].name;
            match replay.verdict() {
                Verdict::Same => {}
                Verdict::Unknown => {
                    let what =
                        format!("{}: inputs of `{name}` are missing: it cannot be followed", path.display());
                    return Err(Failure::Usage(what));
                }
                Verdict::Differs(divergence) => {
                    return Ok(Err(Differs { task, how: divergence.to_string() }));
                }
                Verdict::ScriptDiffers(divergence) => {
                    return Ok(Err(Differs { task, how: divergence.to_string() }));
                }
            }
            let happened = replay.happened().unwrap_or_default();
            tasks[task.index()] = Some(happened.into_iter().map(happening).collect::<Vec<_>>());
        }
    }
    if let Some(missing) = tasks.iter().position(Option::is_none) {
        let node = &cell.nodes[cell.tasks[missing].node.index()].name;
        return Err(Failure::Usage(format!(
            "the recording of node `{node}` is missing: name the files of all"
        )));
    }
    let tasks: Vec<Vec<Happening>> = tasks.into_iter().flatten().collect();
    let start = tasks.iter().flatten().map(|happening| happening.at).min().unwrap_or(0);
    Ok(Ok(Recorded { tasks, whole, start }))
}

fn happening(happening: record::Happening) -> Happening {
    use record::Happened as Was;
    let what = match happening.what {
        Was::Started => Happened::Started,
        Was::Begun => Happened::Begun,
        Was::Came(packet) => Happened::Came(packet),
        // Lives of nodes are not followed: no launcher starts a node again.
        Was::Time | Was::PeerRestarted(_) => Happened::Time,
        Was::Acted(level, ok, value) => Happened::Acted(level, ok, value),
        Was::Chosen(choice) => Happened::Chosen(choice),
        Was::Sent(packet) => Happened::Sent(packet),
        Was::Turn(at, input, passed, end) => Happened::Turn(Turn { at, input, passed, end }),
        Was::Stopped => Happened::Stopped,
    };
    Happening { at: happening.at, task: happening.task, what }
}

/// Without what relays and time change.
fn named(packet: &Packet) -> Packet {
    Packet { remaining: Ticks::ZERO, hops: 0, ..*packet }
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

/// A promise of the cell about its surroundings that the run did not keep.
#[derive(Debug, Serialize)]
struct Breach {
    what: String,
    times: u64,
    /// Seconds since the first task began.
    first: f64,
}

/// Links that took longer than their bound: (from, to, the most, its bound, how often, first when).
type Slow = (NodeId, NodeId, u64, u64, u64, u64);

fn breaches(tasks: &[Vec<Happening>], table: &CellTable) -> Vec<Slow> {
    let mut slow: Vec<Slow> = Vec::new();
    for task in tasks {
        for happening in task {
            let Happened::Came(packet) = &happening.what else { continue };
            let (Some(from), Some(to)) = (table.location(packet.source), table.location(packet.destination))
            else {
                continue;
            };
            let Some(bound) = table.path_bound(from, to).filter(|_| from != to) else { continue };
            let all = tasks.get(packet.source.index()).into_iter().flatten();
            let sent = all.take_while(|other| other.at <= happening.at).filter(
                |other| matches!(&other.what, Happened::Sent(other) if named(other) == named(packet)),
            );
            let Some(took) = sent.last().map(|sent| happening.at - sent.at) else { continue };
            if took <= bound.0 {
                continue;
            }
            match slow.iter_mut().find(|one| (one.0, one.1) == (from, to)) {
                Some(one) => (one.2, one.4, one.5) = (one.2.max(took), one.4 + 1, one.5.min(happening.at)),
                None => slow.push((from, to, took, bound.0, 1, happening.at)),
            }
        }
    }
    slow
}

/// The answer.
#[derive(Debug, Default, Serialize)]
struct Told {
    version: u32,
    cell: String,
    /// Whether the model can do what the run did.
    path: bool,
    /// Whether the links and nodes kept what the cell declares of them.
    within_assumptions: bool,
    complete: bool,
    ended_by: Option<String>,
    seconds: f64,
    inputs: u64,
    turns: u64,
    moves: u64,
    lost: Vec<Lost>,
    /// Ticks.
    late_at_most: u64,
    early_at_most: u64,
    other_values: u64,
    /// Moves of killed nodes after the end of their recordings.
    guessed: u64,
    /// Times that were not rounded down to their tick.
    rounded: u64,
    /// Kinds of step of its scripts, and the lines of those that were not met where `imrs verify` looks.
    kinds: usize,
    kinds_not_met: Vec<String>,
    breaches: Vec<Breach>,
    unexplained: Option<Where>,
}

#[derive(Debug, Serialize)]
struct Lost {
    from: String,
    to: String,
    packets: u64,
}

#[derive(Debug, Serialize)]
struct Where {
    node: String,
    task: String,
    line: Option<usize>,
    seconds: f64,
    why: String,
}

impl Told {
    fn new(loaded: &Loaded, followed: &Followed, steps: &Steps, (slow, start): (Vec<Slow>, u64)) -> Self {
        let cell = loaded.table.cell();
        let seconds = |at: u64| at.saturating_sub(start) as f64 / 1e6;
        let node = |node: usize| cell.nodes[node].name.clone();
        let msec = |us: u64| us as f64 / 1e3;
        let mut breaches: Vec<Breach> = slow
            .into_iter()
            .map(|(from, to, most, bound, times, first)| Breach {
                what: format!(
                    "link {}--{} took {:.1} ms, bound {} ms",
                    node(from.index()),
                    node(to.index()),
                    msec(most),
                    msec(bound)
                ),
                times,
                first: seconds(first),
            })
            .collect();
        // By task and line: how late at most, how often, and when first.
        let mut late: BTreeMap<(TaskId, Option<usize>), (u64, u64, u64)> = BTreeMap::new();
        for one in &followed.late {
            let line = loaded.line(one.task, one.address);
            let all = late.entry((one.task, line)).or_insert((0, 0, one.at));
            *all = (all.0.max(one.ticks), all.1 + 1, all.2);
        }
        for ((task, line), (most, times, first)) in late {
            let line = line.map(|line| format!(" line {line}")).unwrap_or_default();
            let what =
                format!("{}{line} acted up to {} late", cell.tasks[task.index()].name, count(most, "tick"));
            breaches.push(Breach { what, times, first: seconds(first) });
        }
        let unexplained = followed.unexplained.as_ref().map(|Unexplained { at, task, address, why }| {
            let declared = &cell.tasks[task.index()];
            Where {
                node: node(declared.node.index()),
                task: declared.name.clone(),
                line: loaded.line(*task, *address),
                seconds: seconds(*at),
                why: why.clone(),
            }
        });
        let line = |task: TaskId, at| match loaded.line(task, at) {
            Some(line) => format!("{} line {line}", cell.tasks[task.index()].name),
            None => cell.tasks[task.index()].name.clone(),
        };
        let mut kinds_not_met: Vec<String> = steps.missing.iter().map(|&(task, at)| line(task, at)).collect();
        kinds_not_met.dedup();
        let lost =
            followed.lost.iter().map(|&(from, to, packets)| Lost { from: node(from), to: node(to), packets });
        Self {
            version: 1,
            cell: cell.name.clone(),
            path: unexplained.is_none() && followed.ended_by.is_none(),
            within_assumptions: breaches.is_empty(),
            complete: followed.ended_by.is_none(),
            ended_by: followed.ended_by.clone(),
            seconds: seconds(followed.until),
            inputs: followed.inputs,
            turns: followed.turns,
            moves: followed.moves,
            lost: lost.collect(),
            late_at_most: followed.behind,
            early_at_most: followed.ahead,
            other_values: followed.other_values,
            guessed: followed.guessed,
            rounded: followed.rounded,
            kinds: steps.kinds,
            kinds_not_met,
            breaches,
            unexplained,
        }
    }

    fn show(&self, file: &str, out: &mut Output) -> Result<(), Failure> {
        let far = format!(
            "{:.3} s, {}, {}, {}",
            self.seconds,
            count(self.inputs, "input"),
            count(self.turns, "turn"),
            count(self.moves, "move")
        );
        for lost in &self.lost {
            out.line(format!(
                "  {} -> {}: {} never arrived",
                lost.from,
                lost.to,
                count(lost.packets, "packet")
            ))?;
        }
        for breach in &self.breaches {
            let Breach { what, times, first } = breach;
            let text = format!(
                "  outside the assumptions: {what} ({}, first at {first:.3} s)",
                count(*times, "time")
            );
            out.line(Styled(NOTE, text))?;
        }
        match (&self.unexplained, &self.ended_by) {
            (Some(at), _) => {
                let Where { node, task, line, seconds, why } = at;
                let line = line.map(|line| format!(" line {line}")).unwrap_or_default();
                out.line(Styled(BAD, format!("{file}: this run is no path of the model")))?;
                out.line(format!("  after {far}"))?;
                out.line(format!("  at {seconds:.6} s on {node}, {task}{line}: {why}"))
            }
            (None, Some(by)) => {
                let text = format!("{file}: so far this run is a path of the model; cut short: {by}");
                out.line(Styled(NOTE, text))?;
                out.line(format!("  {far}"))
            }
            (None, None) => {
                let late = count(self.late_at_most, "tick");
                let widened = format!(
                    "  beside what `imrs verify` explores: links faster than their bound, actions that end between \
                     their least and most time, nodes that act up to {late} late"
                );
                out.line(Styled(GOOD, format!("{file}: this run is a path of the model ({far})")))?;
                out.line(widened)?;
                let kinds = count(self.kinds as u64, "kind");
                out.line(match &self.kinds_not_met[..] {
                    [] => format!("  {kinds} of step of its scripts: `imrs verify` looks at all of them"),
                    lines => format!(
                        "  {kinds} of step of its scripts: not met where `imrs verify` looks: {}",
                        lines.join(", ")
                    ),
                })
            }
        }
    }
}
