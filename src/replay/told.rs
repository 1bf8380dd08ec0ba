//! The result of `imrs replay --model`, as text for people and as JSON for programs.

use super::assumptions::Breach;
use crate::checks;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count};
use imrs_launch::cells::Loaded;
use imrs_launch::checks::Settlement;
use imrs_model::cell::{Followed, Steps, Unexplained};
use imrs_protocol::TaskId;
use serde::Serialize;

/// How long random paths are followed, in seconds, to look for the steps of the run in the state space of `imrs verify`.
pub const WALKS: f64 = 5.0;

/// The seconds from `start` to `at`.
fn since(start: u64, at: u64) -> f64 {
    at.saturating_sub(start) as f64 / 1e6
}

/// The reason for which it may be unknown whether a run is a path of the model.
const UNSURE: &str = "nodes acted late, or two things happened within one tick, and with times rounded otherwise the model may do what was not found";

/// The result of `imrs replay --model`, as JSON.
#[derive(Debug, Default, Serialize)]
pub struct ReplayAnswer {
    version: u32,
    cell: String,
    /// Whether the run is a path of the model.
    path: bool,
    /// Whether the run kept the cell's assumptions about links, nodes, clocks and actions.
    within_assumptions: bool,
    complete: bool,
    /// Why the result is unknown, if it is.
    unknown: Option<String>,
    ended_by: Option<String>,
    seconds: f64,
    inputs: u64,
    turns: u64,
    moves: u64,
    lost: Vec<Lost>,
    /// The greatest lateness of any act in the run, in ticks.
    late_at_most: u64,
    early_at_most: u64,
    other_values: u64,
    /// How many moves killed nodes must have made after the end of their recordings.
    guessed: u64,
    /// How many times were not rounded down to their own tick, but up or further down.
    rounded: u64,
    /// How many different kinds of step the scripts made. The next field has the lines of those kinds that random paths
    /// through the state space of `imrs verify` did not contain.
    kinds: usize,
    kinds_not_met: Vec<String>,
    breaches: Vec<Breach>,
    /// The verdicts on the cell's checks in this run.
    checks: Settlement,
    unexplained: Option<Where>,
}

#[derive(Debug, Serialize)]
/// Packets of a link that never arrived.
pub struct Lost {
    from: String,
    to: String,
    packets: u64,
}

/// A place in time and in the cell file.
#[derive(Debug, Serialize)]
pub struct Where {
    node: String,
    task: String,
    line: Option<usize>,
    seconds: f64,
    why: String,
}

impl ReplayAnswer {
    /// Makes the result of a run that was followed.
    pub fn new(
        loaded: &Loaded,
        followed: &Followed,
        steps: &Steps,
        start: u64,
        breaches: Vec<Breach>,
        checks: Settlement,
    ) -> Self {
        let cell = loaded.table.cell();
        let seconds = |at| since(start, at);
        let node = |node: usize| cell.nodes[node].name.clone();
        let unexplained =
            followed.unexplained.as_ref().map(|Unexplained { at, task, address, why, .. }| {
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
            complete: followed.ended_by.is_none() && !followed.unsure,
            unknown: followed.unsure.then(|| UNSURE.into()),
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
            checks,
            unexplained,
        }
    }

    /// Makes the result of a run in which the recording of a task differs from what the task's own state machine does.
    pub fn of_task(loaded: &Loaded, task: TaskId, how: String) -> Self {
        let cell = loaded.table.cell();
        let declared = &cell.tasks[task.index()];
        let at = Where {
            node: cell.nodes[declared.node.index()].name.clone(),
            task: declared.name.clone(),
            line: None,
            seconds: 0.0,
            why: how,
        };
        Self { version: 1, cell: cell.name.clone(), complete: true, unexplained: Some(at), ..Self::default() }
    }

    /// Makes the result of a run of which a part is missing.
    pub fn of_gap(loaded: &Loaded, missing: String) -> Self {
        Self { version: 1, cell: loaded.table.cell().name.clone(), unknown: Some(missing), ..Self::default() }
    }

    /// The exit code. It depends on broken checks, on unexplained steps, and on whether the whole run was judged: the
    /// time sufficed, and no evidence is missing.
    pub fn verdict(&self) -> Exit {
        match (&self.unexplained, self.complete) {
            _ if self.checks.is_broken() => Exit::Finding,
            (_, false) if self.ended_by.is_some() => Exit::Budget,
            (_, false) => Exit::Incomplete,
            (Some(_), true) => Exit::Finding,
            (None, true) if self.checks.unjudged().next().is_some() => Exit::Incomplete,
            (None, true) => Exit::Well,
        }
    }

    /// Prints the result for people.
    ///
    /// # Errors
    /// An error if the output cannot be written.
    pub fn show(&self, file: &str, out: &mut Output) -> Result<(), Failure> {
        let unknown = self.unknown.as_ref().map(|why| {
            Styled(
                NOTE,
                format!("{file}: INCOMPLETE: it is unknown whether this run is a path of the model: {why}"),
            )
        });
        if let (Some(unknown), None) = (&unknown, &self.unexplained) {
            return out.line(unknown);
        }
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
            out.line(Styled(NOTE, format!("  outside the assumptions: {breach}")))?;
        }
        match (&self.unexplained, &self.ended_by) {
            (Some(at), _) => {
                let Where { node, task, line, seconds, why } = at;
                let line = line.map(|line| format!(" line {line}")).unwrap_or_default();
                let no = Styled(BAD, format!("{file}: this run is no path of the model"));
                out.line(unknown.unwrap_or(no))?;
                out.line(format!("  after {far}"))?;
                out.line(format!("  at {seconds:.6} s on {node}, {task}{line}: {why}"))
            }
            (None, Some(by)) => {
                let text = format!("{file}: so far this run is a path of the model; cut short: {by}");
                out.line(Styled(NOTE, text))?;
                out.line(format!("  {far}"))
            }
            (None, None) => {
                out.line(Styled(GOOD, format!("{file}: this run is a path of the model ({far})")))?;
                self.compare(out)
            }
        }?;
        checks::show(&self.checks, out)
    }

    /// Prints in which respects the run went beyond what `imrs verify` explores.
    fn compare(&self, out: &mut Output) -> Result<(), Failure> {
        let late = count(self.late_at_most, "tick");
        let late = (self.late_at_most > 0).then(|| format!(", nodes that act up to {late} late"));
        out.line(format!(
            "  beside what `imrs verify` explores: arrivals and ends anywhere within their bounds (its line `looked at` \
             names the times that it tries){}",
            late.unwrap_or_default()
        ))?;
        if self.other_values > 0 {
            let results = count(self.other_values, "result");
            out.line(format!("  and {results} of actions that `imrs verify` does not try"))?;
        }
        if self.guessed > 0 {
            let moves = count(self.guessed, "move");
            out.line(format!("  {moves} of killed nodes after the end of their recordings"))?;
        }
        let kinds = count(self.kinds as u64, "kind");
        let other = if self.other_values > 0 { ", with results that it tries" } else { "" };
        let what = "of step of its scripts (where it waited, what came, where it went on)";
        match &self.kinds_not_met[..] {
            [] => out.line(format!("  {kinds} {what}: `imrs verify` takes steps of all of them{other}")),
            lines => out.line(format!(
                "  {kinds} {what}: {WALKS} s of random walks where `imrs verify` looks did not meet one at {}; the search may",
                lines.join(", ")
            )),
        }
    }
}
