//! The result of checking a cell, as JSON for programs.

use super::advice::help;
use super::happens::RangeAnswer;
use super::limits::not_looked_for;
use super::subject::Subject;
use imrs_model::cell::{
    CellFaults, CellPlan, Concerned, Coverage, Finding, Kind, ManyValues, Pause, Phase, Refused, Times,
    Unfinished, Verdicts,
};
use imrs_protocol::script::Address;
use imrs_protocol::{CellTable, TaskId};
use serde::Serialize;

/// The answer of `imrs verify CELL --format json`.
#[derive(Serialize)]
pub(super) struct Answer<'a> {
    version: u32,
    cell: &'a str,
    file: &'a str,
    complete: bool,
    /// Why the cell was not checked; null if it was.
    not_checked: Option<NotChecked<'a>>,
    looked_at: LookedAt,
    /// What the verdict does not cover.
    not_looked_for: Vec<&'static str>,
    /// The checks of the file.
    claims: Vec<Settled<'a>>,
    findings: Vec<FindingAnswer<'a>>,
    /// Findings that may be intended: tasks that go on for ever without progress.
    warnings: Vec<FindingAnswer<'a>>,
    /// Statements that are never reached with the faults that were searched.
    not_exercised: Vec<Place<'a>>,
    /// The values with which messages of extern tasks were tried in integer fields. The second list has those for
    /// `real` fields.
    outside: &'a [i64],
    outside_real: &'a [f32],
    /// Values that were not tried, because there are too many.
    outside_left_out: &'a [i64],
    outside_real_left_out: &'a [f32],
    /// Statements that are never reached with the tried values of extern tasks. With other values they may be reached.
    not_tried: Vec<Place<'a>>,
    /// Statements that were not reached before a search ended or had a finding. So it is unknown whether they can be reached.
    not_seen: Vec<Place<'a>>,
    /// Times of the cell that are not multiples of its tick: the rounding may cause a finding.
    rounded: Vec<Rounded<'a>>,
    phases: Vec<Searched<'a>>,
}

/// The place of a statement.
#[derive(Serialize)]
pub struct Place<'a> {
    task: &'a str,
    line: usize,
    column: usize,
}

/// Why a cell was not checked.
#[derive(Serialize)]
pub struct NotChecked<'a> {
    why: &'a str,
    task: &'a str,
    line: Option<usize>,
    column: Option<usize>,
}

/// The times at which the search lets events happen.
#[derive(Serialize)]
struct LookedAt {
    tick_us: u64,
    /// The interval of the times at which an action may end, between its least and its most time.
    model_tick_us: Option<u64>,
}

#[derive(Serialize)]
struct Settled<'a> {
    name: &'a str,
    expect: &'static str,
    outcome: &'static str,
    as_expected: bool,
    /// Values that the check reads and that never changed: `r2.active = false`.
    never_changed: Vec<&'a str>,
}

/// A finding.
#[derive(Serialize)]
pub struct FindingAnswer<'a> {
    kind: &'static str,
    with_faults: bool,
    task: Option<&'a str>,
    /// Tasks with the same statements that have the same finding.
    also: Vec<&'a str>,
    line: usize,
    column: usize,
    cause: &'a str,
    /// The advice that usually helps against such a finding.
    help: &'static str,
    /// The states of other tasks at the finding.
    meanwhile: Vec<Meanwhile<'a>>,
    at_ticks: u64,
    /// The uncertain times on the path to the finding, and with which values of them it happens; empty if a search without zones found
    /// it.
    happens: Vec<RangeAnswer<'a>>,
    chart: &'a str,
    /// Whether `--save` saved the finding.
    saved: bool,
}

/// A time that was rounded to the tick.
#[derive(Serialize)]
pub struct Rounded<'a> {
    line: usize,
    column: usize,
    what: &'a str,
}

#[derive(Serialize)]
struct Meanwhile<'a> {
    task: &'a str,
    line: Option<usize>,
    column: Option<usize>,
    does: &'a str,
}

/// The results of one search of the cell.
#[derive(Serialize)]
struct Searched<'a> {
    with_faults: bool,
    bounds: Bounds<'a>,
    /// `ends`: packets take the bound of their link, actions their least or most time. `between`: packets may also
    /// arrive, and actions may end, right after any other event in that time. `every`: they may also do so at every
    /// tick, or every model tick.
    times: &'static str,
    /// How many independent parts the cell has. Each part is searched by itself.
    parts: u32,
    states: u64,
    /// How many runs of a search by zones lead to states with more times than can occur. No finding rests on such
    /// times.
    inexact: u64,
    transitions: u64,
    /// The greatest distance of a state from the start, counted in choices. `whole_depth` is the depth up to which all
    /// states were explored; 0 for a search by zones that a budget ended.
    depth: u64,
    whole_depth: u64,
    complete: bool,
    /// Whether states beyond a finding were not explored.
    pruned: bool,
    /// The budget that ended the search; null if no budget did.
    ended_by: Option<&'a str>,
    /// The states that the search had found and not explored when a budget ended it; null if it had explored all of them.
    unfinished: Option<Left<'a>>,
    /// A search of the same faults at finer times that a budget ended before this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    finer: Option<Box<Searched<'a>>>,
    seconds: f64,
}

/// The states that a search had found and not explored, and what makes the search large.
#[derive(Serialize)]
struct Left<'a> {
    states: u64,
    /// How many of the states that were not explored the following fields describe. Then, how many of the described
    /// states differ in something other than times.
    sampled: u64,
    apart_from_times: u64,
    /// The variables with the most values.
    variables: Vec<Variable<'a>>,
}

#[derive(Serialize)]
struct Variable<'a> {
    task: &'a str,
    name: &'a str,
    values: u64,
}

/// The faults that a search may use: how many of each kind, the nodes that crash, and the ends of the links that are cut.
#[derive(Serialize)]
struct Bounds<'a> {
    loss: u8,
    dup: u8,
    reorder: u8,
    fail: u8,
    drift: u8,
    crash: Vec<&'a str>,
    cut: Vec<[&'a str; 2]>,
    pause: Vec<Pausing<'a>>,
}

/// A pause: the node, or null for any node, and its longest duration.
#[derive(Serialize)]
struct Pausing<'a> {
    node: Option<&'a str>,
    ticks: u32,
}

impl Subject {
    /// The JSON answer. `saved` is the number of the finding that `--save` saved.
    pub(super) fn answer<'a>(
        &'a self,
        plan: &'a CellPlan,
        verdicts: &'a Verdicts,
        saved: Option<usize>,
    ) -> Answer<'a> {
        let settled = |check: usize| {
            let fails = verdicts.findings.iter().any(|f| f.kind == Kind::Check && f.check == Some(check));
            // After a finding that ends its path, the states beyond it were not explored.
            let whole = verdicts.is_complete() && !verdicts.phases.iter().any(|phase| phase.pruned);
            let outcome = match (fails, whole) {
                (true, _) => "fails",
                (false, true) => "holds",
                (false, false) => "unknown",
            };
            let still = verdicts.still.iter().filter(|(of, _)| *of == check);
            Settled {
                name: &self.lowered.checks[check].name,
                expect: "holds",
                outcome,
                as_expected: outcome == "holds",
                never_changed: still.map(|(_, what)| what.as_str()).collect(),
            }
        };
        Answer {
            version: 1,
            cell: &self.lowered.cell.name,
            file: &self.file,
            complete: verdicts.is_complete(),
            not_checked: verdicts.refused.as_ref().map(|refused| self.not_checked(refused)),
            looked_at: LookedAt { tick_us: self.tick_us, model_tick_us: self.model_tick_us },
            not_looked_for: not_looked_for(plan),
            claims: (0..self.lowered.checks.len()).map(settled).collect(),
            findings: (1..)
                .zip(&verdicts.findings)
                .map(|(number, finding)| self.told(finding, saved == Some(number)))
                .collect(),
            warnings: verdicts.warnings.iter().map(|warning| self.told(warning, false)).collect(),
            not_exercised: self.places(&verdicts.not_exercised),
            outside: &verdicts.outside.whole,
            outside_real: &verdicts.outside.real,
            outside_left_out: &verdicts.outside.left_out,
            outside_real_left_out: &verdicts.outside.real_left_out,
            not_tried: self.places(&verdicts.not_tried),
            not_seen: self.places(&verdicts.not_seen),
            rounded: self.rounded_times(),
            phases: verdicts.phases.iter().map(|phase| self.searched(plan, phase)).collect(),
        }
    }

    /// The times that were rounded to the tick.
    pub fn rounded_times(&self) -> Vec<Rounded<'_>> {
        self.rounded().map(|(line, column, what)| Rounded { line, column, what }).collect()
    }

    /// The reason for which the cell was not checked.
    pub fn not_checked<'a>(&'a self, refused: &'a Refused) -> NotChecked<'a> {
        let place = self.place(refused.task, refused.at);
        let (line, column) = (place.map(|place| place.0), place.map(|place| place.1));
        NotChecked { why: &refused.why, task: self.task(refused.task), line, column }
    }

    /// The places of these statements.
    pub fn places(&self, which: &[(TaskId, Address)]) -> Vec<Place<'_>> {
        let place = |&(task, at): &(TaskId, Address)| {
            let (line, column, _) = self.place(task, at)?;
            Some(Place { task: self.task(task), line, column })
        };
        which.iter().filter_map(place).collect()
    }

    /// The JSON of a finding.
    pub fn told<'a>(&'a self, finding: &'a Finding, saved: bool) -> FindingAnswer<'a> {
        let (line, column, _) = self.place_of(finding);
        let meanwhile = |other: &'a Concerned| {
            let place = other.at.and_then(|at| self.place(other.task, at));
            let (line, column) = (place.map(|place| place.0), place.map(|place| place.1));
            Meanwhile { task: self.task(other.task), line, column, does: &other.does }
        };
        FindingAnswer {
            kind: finding.kind.name(),
            with_faults: finding.phase == Phase::Faults,
            task: finding.task.map(|task| self.task(task)),
            also: finding.also.iter().map(|&task| self.task(task)).collect(),
            line,
            column,
            cause: &finding.cause,
            help: help(finding.kind),
            meanwhile: finding.others.iter().map(meanwhile).collect(),
            at_ticks: finding.at_ticks,
            happens: self.ranges(finding),
            chart: &finding.chart,
            saved,
        }
    }

    fn searched<'a>(&'a self, plan: &'a CellPlan, phase: &'a Coverage) -> Searched<'a> {
        let with_faults = phase.phase == Phase::Faults;
        let faults = plan.faults.get(phase.hypothesis).filter(|_| with_faults);
        Searched {
            with_faults,
            bounds: bounds(&plan.table, faults),
            times: match phase.times {
                Times::Auto | Times::Ends => "ends",
                Times::Between => "between",
                Times::Every => "every",
                Times::Zones => "zones",
            },
            parts: phase.parts,
            states: phase.states,
            inexact: phase.inexact,
            transitions: phase.moves,
            depth: phase.depth,
            whole_depth: phase.whole_depth,
            complete: phase.complete,
            pruned: phase.pruned,
            ended_by: phase.ended_by.as_deref(),
            unfinished: phase.unfinished.as_ref().map(|left| self.left(left)),
            finer: phase.finer.as_ref().map(|finer| Box::new(self.searched(plan, finer))),
            seconds: phase.seconds,
        }
    }

    fn left<'a>(&'a self, left: &'a Unfinished) -> Left<'a> {
        let variables = left.variables.iter();
        let variable =
            |of: &'a ManyValues| Variable { task: self.task(of.task), name: &of.name, values: of.values };
        Left {
            states: left.open,
            sampled: left.sampled,
            apart_from_times: left.apart_from_times,
            variables: variables.map(variable).collect(),
        }
    }
}

fn bounds<'a>(table: &'a CellTable, faults: Option<&CellFaults>) -> Bounds<'a> {
    let cell = table.cell();
    let node = |at: usize| cell.nodes.get(at).map_or("?", |node| node.name.as_str());
    let count = |of: fn(&CellFaults) -> u8| faults.map_or(0, of);
    let crash = faults.map_or(&[][..], |faults| &faults.crash);
    let pauses = faults.map_or(&[][..], |faults| &faults.pause);
    let pausing = |pause: &Pause| Pausing { node: pause.node.map(|at| node(at.index())), ticks: pause.most };
    let links = faults.map_or(&[][..], |faults| &faults.cut).iter().filter_map(|&at| cell.links.get(at));
    Bounds {
        loss: count(|faults| faults.loss),
        dup: count(|faults| faults.dup),
        reorder: count(|faults| faults.reorder),
        fail: count(|faults| faults.fail),
        drift: count(|faults| faults.drift),
        crash: crash.iter().map(|at| node(at.index())).collect(),
        cut: links.map(|link| [node(link.a.index()), node(link.b.index())]).collect(),
        pause: pauses.iter().map(pausing).collect(),
    }
}
