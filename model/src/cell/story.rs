//! Replays the path to a finding: records what each task does in each step, and draws a chart.

use super::context::{Origin, context};
use super::judge::Shown;
use super::parts::parts;
use super::plan::{CellFaults, CellPlan, Conduct, Part};
use super::reader::Reader;
use super::run_state::{CellMove, RunState};
use super::verdict::{Concerned, Finding, Phase, Step};
use super::view::view;
use crate::cell_state::chart::Lanes;
use crate::cell_state::script::ScriptReaction;
use crate::chart::{ChartRecorder, Folding, Note, chart};
use crate::state::Violation;
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, End};
use std::sync::Arc;

/// The greatest number of lines of a chart. A longer chart loses lines in its middle.
const LINES: usize = 160;

/// A replayed path: its steps, its chart and the cause of the finding.
pub(super) struct Explained {
    pub steps: Vec<Step>,
    pub chart: String,
    pub ticks: u64,
    /// The cause of the finding, with the values that explain it.
    pub cause: String,
    pub others: Vec<Concerned>,
}

/// Replays a path, and records its steps and its chart.
pub(super) fn tell(
    plan: &Arc<CellPlan>,
    faults: &CellFaults,
    moves: &[CellMove],
    shown: &Shown,
) -> Explained {
    let mut steps = Vec::new();
    let mut origin = Origin::new(&RunState::new(plan, faults), shown.check);
    let ReplayedPath { recorder, run_state, begun } = walk(plan, faults, moves, |walked| {
        steps.push(walked.step());
        origin.note(walked.run_state, walked.turns);
    });
    let (mut cause, others) = context(&run_state, shown, &begun);
    cause.push_str(&origin.words(&run_state));
    let (names, notes) = within(plan, plan.part.as_ref(), recorder.notes);
    let drawn = chart(&names, &notes, &cause, Folding::Repeats);
    Explained { steps, chart: shorten(&drawn), ticks: run_state.passed, cause, others }
}

/// The finding that the last of these moves shows, with its path.
pub(super) fn finding(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    moves: Vec<CellMove>,
    shown: &Shown,
) -> Finding {
    let told = tell(plan, faults, &moves, shown);
    let Shown { kind, task, address, check, couple, .. } = *shown;
    Finding {
        kind,
        phase,
        hypothesis,
        times: plan.times,
        part: plan.part.as_ref().map(|part| part.number),
        task: task.map(TaskId::from_index),
        also: Vec::new(),
        address,
        check,
        couple,
        others: told.others,
        cause: told.cause,
        at_ticks: told.ticks,
        ranges: Vec::new(),
        moves,
        steps: told.steps,
        chart: told.chart,
    }
}

/// A step of a path while the path is replayed.
pub(super) struct Walked<'a> {
    /// The cell after the step. Its log holds what happened in the step.
    pub run_state: &'a RunState,
    pub lanes: &'a Lanes,
    /// The names of the ports.
    pub ports: &'a [String],
    pub step: CellMove,
    pub notes: &'a [Note],
    /// How many of the step's notes, counted from the end, are about scripts that ended.
    pub ended: usize,
    /// What the scripts did in the step.
    pub turns: &'a [ScriptReaction],
}

impl Walked<'_> {
    /// The step as data that is independent of the cell.
    pub fn step(&self) -> Step {
        let tasks = (0..self.run_state.plan.tasks.len()).map(|task| view(self.run_state, task)).collect();
        Step { tick: self.run_state.passed, step: self.step, notes: self.notes.to_vec(), tasks }
    }
}

/// A path that has been replayed.
pub(super) struct ReplayedPath {
    pub recorder: ChartRecorder,
    /// The cell at the end of the path.
    pub run_state: RunState,
    /// The statement that each task began last.
    pub begun: Vec<Option<Address>>,
}

/// Replays a path, and passes each step to `each`.
pub(super) fn walk(
    plan: &Arc<CellPlan>,
    faults: &CellFaults,
    moves: &[CellMove],
    mut each: impl FnMut(&Walked<'_>),
) -> ReplayedPath {
    let mut run_state = RunState::new(plan, faults);
    run_state.cell.keep_log = true;
    let lanes = Lanes::new(&run_state.cell.plan);
    let ports = plan.table.cell().ports.iter().map(|port| port.name.clone()).collect();
    let timers = |task: &Conduct| match task {
        Conduct::Program { program, .. } => program.timers.clone(),
        Conduct::Extern(_) => Vec::new(),
    };
    let timers = plan.tasks.iter().map(timers).collect();
    let mut recorder = ChartRecorder::new(lanes.names.clone()).naming(ports, timers);
    // The steps that scripts take before the first move are drawn together with that move.
    let turns = run_state.cell.turns.replace(Vec::new()).unwrap_or_default();
    let mut begun = vec![None; plan.tasks.len()];
    let mut reader = Reader::default();
    note_begun(&turns, &mut begun);
    ends(&run_state, &turns, &mut recorder, 0, &reader);
    let mut from = 0;
    for (at, &step) in moves.iter().enumerate() {
        run_state.cell.log.clear();
        let arrow = packet(&run_state, step, &lanes);
        let before = describe(&run_state, step);
        let acted = match step {
            CellMove::Acted(task, level, ..) => reader.of_action(&run_state, usize::from(task), level),
            _ => None,
        };
        reader.before(&run_state, &begun, arrow.map(|(_, packet, _)| packet));
        if !run_state.survives(step) {
            run_state = before_panic(plan, faults, &moves[..at]);
        }
        let shown = u32::try_from(run_state.passed).unwrap_or(u32::MAX);
        if let Some((ends, packet, outcome)) = arrow {
            let (line, values) = (reader.of_packet(&run_state, &packet), plan.legend.of_packet(&packet));
            explained(&mut recorder, line, values.as_deref(), |recorder| {
                recorder.arrow(shown, ends, &packet, outcome);
            });
        }
        if let Some((lane, text)) = before {
            let lane = match lane {
                Lane::Task(task) => task,
                Lane::Node(node) => lanes.on_node(node),
            };
            explained(&mut recorder, acted, None, |recorder| recorder.event(shown, lane, &text));
        }
        let turns = run_state.cell.turns.as_mut().map(std::mem::take).unwrap_or_default();
        reader.after(&turns, &run_state.cell.log);
        for effect in &run_state.cell.log {
            let (line, values) = reader.of_effect(&run_state, effect);
            explained(&mut recorder, line, values.as_deref(), |recorder| {
                lanes.effect(recorder, shown, effect);
            });
        }
        let others = recorder.notes.len();
        note_begun(&turns, &mut begun);
        ends(&run_state, &turns, &mut recorder, shown, &reader);
        let (notes, ended) = (&recorder.notes[from..], recorder.notes.len() - others);
        let ports = recorder.ports();
        each(&Walked { run_state: &run_state, lanes: &lanes, ports, step, notes, ended, turns: &turns });
        from = recorder.notes.len();
        if run_state.cell.violation.is_some() {
            break;
        }
    }
    ReplayedPath { recorder, run_state, begun }
}

/// A panic leaves the cell half changed. So the moves before the panic are made again on a new cell.
fn before_panic(plan: &Arc<CellPlan>, faults: &CellFaults, moves: &[CellMove]) -> RunState {
    let mut run_state = RunState::new(plan, faults);
    moves.iter().for_each(|&step| run_state.apply(step));
    run_state.cell.turns.iter_mut().for_each(Vec::clear);
    run_state.cell.violation = Some(Violation::Panic);
    run_state
}

/// Adds to each note the line of the cell's text and the values, and draws the notes.
fn explained(
    recorder: &mut ChartRecorder,
    line: Option<u32>,
    values: Option<&str>,
    draw: impl FnOnce(&mut ChartRecorder),
) {
    let before = recorder.notes.len();
    draw(recorder);
    recorder.notes[before..].iter_mut().for_each(|note| note.explain(line, values));
}

fn note_begun(turns: &[ScriptReaction], begun: &mut [Option<Address>]) {
    for turn in turns {
        if let (Some(last), Some(&at)) = (begun.get_mut(turn.task), turn.passed.last()) {
            *last = Some(at);
        }
    }
}

enum Lane {
    Task(usize),
    Node(u8),
}

type Arrow = ((usize, usize), imrs_protocol::Packet, &'static str);

fn packet(run_state: &RunState, step: CellMove, lanes: &Lanes) -> Option<Arrow> {
    let i = usize::from(step.packet()?);
    let outcome = match step {
        CellMove::Deliver(_) if run_state.cell.is_behind(i) => "OVERTAKES",
        CellMove::Lose(_) => "LOST",
        CellMove::Duplicate(_) => "TWICE",
        CellMove::Cut(..) | CellMove::Vanish(_) => "CUT OFF",
        _ => "",
    };
    let carried = run_state.cell.in_flight.get(i)?;
    let (from, to, _) = run_state.cell.links[usize::from(carried.link)];
    let packet = carried.packet;
    Some(((lanes.lane(from, packet.source), lanes.lane(to, packet.destination)), packet, outcome))
}

fn describe(run_state: &RunState, step: CellMove) -> Option<(Lane, String)> {
    Some(match step {
        CellMove::Acted(task, level, ok, value) => {
            let at = usize::from(task);
            let actor = run_state.cell.bodies[at].actor.as_ref()?;
            let running = actor.runs(level)?;
            let action =
                actor.host.program.actions.get(usize::from(running.action)).map_or("?", String::as_str);
            let number = run_state.value(at, level, value);
            let text = match (ok, number) {
                (false, _) => format!("{action} FAILS"),
                (true, 0) => format!("{action} ends"),
                (true, number) => format!("{action} ends: {number}"),
            };
            (Lane::Task(at), text)
        }
        CellMove::Choose(task, choice) => (Lane::Task(usize::from(task)), format!("chooses {choice}")),
        CellMove::Crash(number) => {
            (Lane::Node(super::run_state::small(run_state.crash_node(number))), "CRASHES".into())
        }
        CellMove::Restart(node) => (Lane::Node(node), "restarts".into()),
        CellMove::Pause(_, node) | CellMove::PauseNext(_, node) => (Lane::Node(node), "PAUSES".into()),
        CellMove::PauseBefore(_, node) => (Lane::Node(node), "PAUSES, before its action".into()),
        CellMove::Wake(node) => {
            let slept = run_state.cell.slept(usize::from(node)).unwrap_or(0);
            let ticks = if slept == 1 { "tick" } else { "ticks" };
            (Lane::Node(node), format!("goes on after {slept} {ticks}"))
        }
        CellMove::Drift(node, more) => {
            (Lane::Node(node), if more { "counts a tick twice" } else { "misses a tick" }.into())
        }
        CellMove::Pass
        | CellMove::Deliver(_)
        | CellMove::Lose(_)
        | CellMove::Duplicate(_)
        | CellMove::Cut(..)
        | CellMove::Vanish(_)
        | CellMove::Mend(..)
        | CellMove::GoOn(..)
        | CellMove::Takes(..)
        | CellMove::Stay(_)
        | CellMove::Begin(_)
        | CellMove::Take(..) => return None,
    })
}

/// Draws that scripts ended with the last move.
fn ends(
    run_state: &RunState,
    turns: &[ScriptReaction],
    recorder: &mut ChartRecorder,
    tick: u32,
    reader: &Reader,
) {
    for turn in turns {
        let text = match &turn.end {
            None => continue,
            Some(End::Finished) => "ends".into(),
            Some(End::Fenced) => "ends, FENCED".into(),
            Some(End::Aborted(_)) => "ABORTS".into(),
            Some(End::Assertion(_)) => "ASSERTION FAILS".into(),
            Some(End::Fault { fault, .. }) => format!("FAULT: {fault}"),
        };
        explained(recorder, reader.of_end(run_state, turn), None, |recorder| {
            recorder.event(tick, turn.task, &text);
        });
    }
}

/// Keeps the first and the last lines of a long chart.
pub(super) fn shorten(chart: &str) -> String {
    let lines: Vec<&str> = chart.lines().collect();
    if lines.len() <= LINES {
        return chart.to_owned();
    }
    let left_out = lines.len() - LINES;
    let head = lines[..LINES / 4].join("\n");
    let tail = lines[lines.len() - (LINES - LINES / 4)..].join("\n");
    format!("{head}\n      ... {left_out} lines left out ...\n{tail}")
}

/// The lane names of a part, and the notes with lanes renumbered for that part. `None` stands for the whole cell.
#[must_use]
pub fn drawn(plan: &CellPlan, part: Option<usize>, notes: Vec<Note>) -> (Vec<String>, Vec<Note>) {
    let part = part.and_then(|number| parts(plan).into_iter().nth(number));
    within(plan, part.as_ref(), notes)
}

/// As [`drawn`], with the part itself instead of its number.
pub(super) fn within(plan: &CellPlan, part: Option<&Part>, mut notes: Vec<Note>) -> (Vec<String>, Vec<Note>) {
    let lanes = Lanes::of(&plan.table);
    let Some(part) = part else { return (lanes.names, notes) };
    let kept = lanes.on_nodes(|node| part.has_node(node));
    let place = |lane: &mut usize| *lane = kept.iter().position(|kept| kept == lane).unwrap_or(0);
    for note in &mut notes {
        match note {
            Note::Event { lane, .. } => place(lane),
            Note::Packet { from, to, .. } => [from, to].into_iter().for_each(place),
            Note::Remark { .. } => {}
        }
    }
    (kept.into_iter().map(|lane| lanes.names[lane].clone()).collect(), notes)
}
