//! Replays the path to a finding: step by step with what each task does, and as a chart.

use super::context::{Origin, context};
use super::course::{CellMove, Course};
use super::judge::Shown;
use super::parts::parts;
use super::plan::{CellFaults, CellPlan, Conduct, Part};
use super::reader::Reader;
use super::verdict::{Concerned, Finding, Phase, Step};
use super::view::view;
use crate::chart::{Folding, Note, Pen, chart};
use crate::floor::chart::Lanes;
use crate::floor::script::ScriptTurn;
use crate::state::Violation;
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, End};
use std::sync::Arc;

/// The most lines of a chart. A longer one loses lines between its head and its end.
const LINES: usize = 160;

/// A path with its steps, its chart and its cause.
pub(super) struct Told {
    pub steps: Vec<Step>,
    pub chart: String,
    pub ticks: u64,
    /// The cause, with the values that explain it.
    pub cause: String,
    pub others: Vec<Concerned>,
}

/// Replays a path, and records its steps and its chart.
pub(super) fn tell(plan: &Arc<CellPlan>, faults: &CellFaults, moves: &[CellMove], shown: &Shown) -> Told {
    let mut steps = Vec::new();
    let mut origin = Origin::new(&Course::new(plan, faults), shown.check);
    let Way { pen, course, begun } = walk(plan, faults, moves, |walked| {
        steps.push(walked.step());
        origin.note(walked.course, walked.turns);
    });
    let (mut cause, others) = context(&course, shown, &begun);
    cause.push_str(&origin.words(&course));
    let (names, notes) = within(plan, plan.part.as_ref(), pen.notes);
    let drawn = chart(&names, &notes, &cause, Folding::Repeats);
    Told { steps, chart: shorten(&drawn), ticks: course.passed, cause, others }
}

/// The finding that the last of these moves shows.
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
        moves,
        steps: told.steps,
        chart: told.chart,
    }
}

/// A step of a path that is replayed.
pub(super) struct Walked<'a> {
    /// The cell after the step. Its log holds what the step showed.
    pub course: &'a Course,
    pub lanes: &'a Lanes,
    /// The names of the ports.
    pub ports: &'a [String],
    pub step: CellMove,
    pub notes: &'a [Note],
    /// How many notes, the last ones, are about scripts that ended.
    pub ended: usize,
    /// What the scripts did.
    pub turns: &'a [ScriptTurn],
}

impl Walked<'_> {
    /// The step as data that is independent of the cell.
    pub fn step(&self) -> Step {
        let tasks = (0..self.course.plan.tasks.len()).map(|task| view(self.course, task)).collect();
        Step { tick: self.course.passed, step: self.step, notes: self.notes.to_vec(), tasks }
    }
}

/// A path that was replayed.
pub(super) struct Way {
    pub pen: Pen,
    /// The cell at its end.
    pub course: Course,
    /// The statement that each task began last.
    pub begun: Vec<Option<Address>>,
}

/// Replays a path, and passes each step to `each`.
pub(super) fn walk(
    plan: &Arc<CellPlan>,
    faults: &CellFaults,
    moves: &[CellMove],
    mut each: impl FnMut(&Walked<'_>),
) -> Way {
    let mut course = Course::new(plan, faults);
    course.floor.keep_log = true;
    let lanes = Lanes::new(&course.floor.plan);
    let ports = plan.table.cell().ports.iter().map(|port| port.name.clone()).collect();
    let timers = |task: &Conduct| match task {
        Conduct::Program { program, .. } => program.timers.clone(),
        Conduct::Extern(_) => Vec::new(),
    };
    let timers = plan.tasks.iter().map(timers).collect();
    let mut pen = Pen::new(lanes.names.clone()).naming(ports, timers);
    // What scripts do before the first move is drawn with it.
    let turns = course.floor.turns.replace(Vec::new()).unwrap_or_default();
    let mut begun = vec![None; plan.tasks.len()];
    let mut reader = Reader::default();
    note_begun(&turns, &mut begun);
    ends(&course, &turns, &mut pen, 0, &reader);
    let mut from = 0;
    for (at, &step) in moves.iter().enumerate() {
        course.floor.log.clear();
        let arrow = packet(&course, step, &lanes);
        let before = describe(&course, step);
        let acted = match step {
            CellMove::Acted(task, level, ..) => reader.of_action(&course, usize::from(task), level),
            _ => None,
        };
        reader.before(&course, &begun, arrow.map(|(_, packet, _)| packet));
        if !course.survives(step) {
            course = before_panic(plan, faults, &moves[..at]);
        }
        let shown = u32::try_from(course.passed).unwrap_or(u32::MAX);
        if let Some((ends, packet, fate)) = arrow {
            let (line, values) = (reader.of_packet(&course, &packet), plan.legend.of_packet(&packet));
            explained(&mut pen, line, values.as_deref(), |pen| pen.arrow(shown, ends, &packet, fate));
        }
        if let Some((lane, text)) = before {
            let lane = match lane {
                Lane::Task(task) => task,
                Lane::Node(node) => lanes.on_node(node),
            };
            explained(&mut pen, acted, None, |pen| pen.event(shown, lane, &text));
        }
        let turns = course.floor.turns.as_mut().map(std::mem::take).unwrap_or_default();
        reader.after(&turns, &course.floor.log);
        for effect in &course.floor.log {
            let (line, values) = reader.of_effect(&course, effect);
            explained(&mut pen, line, values.as_deref(), |pen| lanes.effect(pen, shown, effect));
        }
        let others = pen.notes.len();
        note_begun(&turns, &mut begun);
        ends(&course, &turns, &mut pen, shown, &reader);
        let (notes, ended) = (&pen.notes[from..], pen.notes.len() - others);
        let ports = pen.ports();
        each(&Walked { course: &course, lanes: &lanes, ports, step, notes, ended, turns: &turns });
        from = pen.notes.len();
        if course.floor.violation.is_some() {
            break;
        }
    }
    Way { pen, course, begun }
}

/// A panic leaves the cell half changed, so this makes the moves before it again on a new one.
fn before_panic(plan: &Arc<CellPlan>, faults: &CellFaults, moves: &[CellMove]) -> Course {
    let mut course = Course::new(plan, faults);
    moves.iter().for_each(|&step| course.apply(step));
    course.floor.turns.iter_mut().for_each(Vec::clear);
    course.floor.violation = Some(Violation::Panic);
    course
}

/// Draws notes, and adds their line and their values.
fn explained(pen: &mut Pen, line: Option<u32>, values: Option<&str>, draw: impl FnOnce(&mut Pen)) {
    let before = pen.notes.len();
    draw(pen);
    pen.notes[before..].iter_mut().for_each(|note| note.explain(line, values));
}

fn note_begun(turns: &[ScriptTurn], begun: &mut [Option<Address>]) {
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

fn packet(course: &Course, step: CellMove, lanes: &Lanes) -> Option<Arrow> {
    let i = usize::from(step.packet()?);
    let fate = match step {
        CellMove::Deliver(_) if course.floor.is_behind(i) => "OVERTAKES",
        CellMove::Lose(_) => "LOST",
        CellMove::Duplicate(_) => "TWICE",
        CellMove::Cut(..) | CellMove::Vanish(_) => "CUT OFF",
        _ => "",
    };
    let crossing = course.floor.crossings.get(i)?;
    let (from, to, _) = course.floor.links[usize::from(crossing.link)];
    let packet = crossing.packet;
    Some(((lanes.lane(from, packet.source), lanes.lane(to, packet.destination)), packet, fate))
}

fn describe(course: &Course, step: CellMove) -> Option<(Lane, String)> {
    Some(match step {
        CellMove::Acted(task, level, ok, value) => {
            let at = usize::from(task);
            let actor = course.floor.bodies[at].actor.as_ref()?;
            let running = actor.runs(level)?;
            let action = actor.program.actions.get(usize::from(running.action)).map_or("?", String::as_str);
            let number = course.value(at, level, value);
            let text = match (ok, number) {
                (false, _) => format!("{action} FAILS"),
                (true, 0) => format!("{action} ends"),
                (true, number) => format!("{action} ends: {number}"),
            };
            (Lane::Task(at), text)
        }
        CellMove::Choose(task, choice) => (Lane::Task(usize::from(task)), format!("chooses {choice}")),
        CellMove::Crash(number) => {
            (Lane::Node(super::course::small(course.crash_node(number))), "CRASHES".into())
        }
        CellMove::Restart(node) => (Lane::Node(node), "restarts".into()),
        CellMove::Pause(_, node) | CellMove::PauseNext(_, node) => (Lane::Node(node), "PAUSES".into()),
        CellMove::PauseBefore(_, node) => (Lane::Node(node), "PAUSES, before its action".into()),
        CellMove::Wake(node) => {
            let slept = course.floor.slept(usize::from(node)).unwrap_or(0);
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

/// Draws the scripts that ended with the last move.
fn ends(course: &Course, turns: &[ScriptTurn], pen: &mut Pen, tick: u32, reader: &Reader) {
    for turn in turns {
        let text = match &turn.end {
            None => continue,
            Some(End::Finished) => "ends".into(),
            Some(End::Fenced) => "ends, FENCED".into(),
            Some(End::Aborted(_)) => "ABORTS".into(),
            Some(End::Assertion(_)) => "ASSERTION FAILS".into(),
            Some(End::Fault { fault, .. }) => format!("FAULT: {fault}"),
        };
        explained(pen, reader.of_end(course, turn), None, |pen| pen.event(tick, turn.task, &text));
    }
}

/// Keeps the head and the end of a long chart.
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

/// The lane names of a part, and notes with their lanes renumbered for it. `None`: those of the whole cell.
#[must_use]
pub fn drawn(plan: &CellPlan, part: Option<usize>, notes: Vec<Note>) -> (Vec<String>, Vec<Note>) {
    let part = part.and_then(|number| parts(plan).into_iter().nth(number));
    within(plan, part.as_ref(), notes)
}

/// The same for a given part.
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
