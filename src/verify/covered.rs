//! Texts about how far a search came: what it covered. If a budget ended the search, they also say what makes it large,
//! and what would let it end.

use super::subject::Subject;
use crate::failure::Failure;
use crate::output::{HEAD, NOTE, Output, Styled, count, grouped};
use imrs_model::cell::{CellPlan, Coverage, Phase, Times};

/// If there are this many states for each state that differs in something other than times, the text names times as a reason.
const MANY_TIMES: u64 = 3;

/// Shows a phase: its faults and times, what it covered, and how far a search at finer times came before.
///
/// # Errors
/// [`Failure::Output`].
pub(super) fn show(
    subject: &Subject,
    plan: &CellPlan,
    phase: &Coverage,
    out: &mut Output,
) -> Result<(), Failure> {
    let note = |text: String| Styled(NOTE, text);
    out.line(Styled(HEAD, bounds(plan, (phase.phase, phase.hypothesis), phase.times)))?;
    out.line(format!("  {}", looked_at(phase)))?;
    explained(subject, plan, phase).into_iter().try_for_each(|said| out.line(note(format!("  {said}"))))?;
    let Some(finer) = &phase.finer else { return Ok(()) };
    out.line(note(format!("  before, {}: {}", at(plan, finer.times), looked_at(finer))))?;
    explained(subject, plan, finer).into_iter().try_for_each(|said| out.line(note(format!("    {said}"))))
}

/// What a phase covered, in one line.
fn looked_at(phase: &Coverage) -> String {
    let whole = match (&phase.ended_by, phase.pruned) {
        (Some(by), _) => {
            // A search by zones does not explore states in the order of their depth, so it has no depth up to which
            // it is complete.
            let is_by_zones = phase.times == Times::Zones;
            let whole = (!is_by_zones).then(|| {
                format!("every order of events was looked at up to its choice {}", grouped(phase.whole_depth))
            });
            let said: Vec<String> = share(phase).into_iter().chain(whole).collect();
            [format!("cut short, {by}"), said.join(", and ")].join(if said.is_empty() { "" } else { ": " })
        }
        (None, true) => "everything up to the findings".into(),
        (None, false) => "everything within the bounds".into(),
    };
    let parts = match phase.parts {
        0 | 1 => String::new(),
        parts => format!("{parts} independent parts, each by itself: "),
    };
    format!(
        "{parts}{}, {}, {:.1} s; {whole}",
        count(phase.states, "state"),
        count(phase.moves, "step"),
        phase.seconds
    )
}

/// How many of the found states were explored, too; `None` if all of them were explored. How many states were not even found is unknown.
fn share(phase: &Coverage) -> Option<String> {
    let left = phase.unfinished.as_ref()?;
    let done = phase.states.saturating_sub(left.open);
    let percent = (done * 100).checked_div(phase.states).unwrap_or(0);
    Some(format!("{} of these states were looked at ({percent} % of those found)", grouped(done)))
}

/// Sentences that explain a search that stands for more times than can occur, or that is unfinished.
fn explained(subject: &Subject, plan: &CellPlan, phase: &Coverage) -> Vec<String> {
    let mut said = unfinished(subject, plan, phase);
    if phase.inexact > 0 {
        said.push(format!(
            "{} of these states stand for more times than can occur: no finding rests on that, but a statement may count as reached that is not",
            grouped(phase.inexact)
        ));
    }
    said
}

/// Sentences that explain an unfinished search.
fn unfinished(subject: &Subject, plan: &CellPlan, phase: &Coverage) -> Vec<String> {
    let Some(left) = &phase.unfinished else { return Vec::new() };
    let (mut large, mut smaller): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    let alike = left.sampled.checked_div(left.apart_from_times).unwrap_or(0);
    if alike >= MANY_TIMES {
        large.push(format!("times ({alike} states for each one that differs in anything else)"));
        smaller.push("write one time where the spread of an interval is not the point".into());
    }
    for variable in &left.variables {
        let task = subject.task(variable.task);
        large.push(format!("`{}` of {task} ({} values)", variable.name, grouped(variable.values)));
    }
    if let Some(first) = left.variables.first() {
        smaller.push(format!("let `{}` have fewer values", first.name));
    }
    let faults = plan.faults.get(phase.hypothesis).filter(|_| phase.phase == Phase::Faults);
    if faults.is_some_and(|faults| faults.kinds() > 1) {
        smaller.push("declare each of these faults in a `faults` line of its own".into());
    }
    smaller.push("give it more (`--within 10m`, `--memory 8G`)".into());
    let large = (!large.is_empty()).then(|| format!("what makes it large: {}", large.join(", ")));
    large.into_iter().chain([format!("to let it end: {}", smaller.join("; or "))]).collect()
}

/// The faults and times of a phase as text: those that the cell declares, and those that the user added.
pub(super) fn bounds(plan: &CellPlan, (phase, hypothesis): (Phase, usize), times: Times) -> String {
    let faults = match phase {
        Phase::FaultFree => "Without faults".into(),
        Phase::Faults => format!("With at most {}", faults(plan, hypothesis)),
    };
    format!("{faults}, {}", at(plan, times))
}

/// The times of a search as text.
fn at(plan: &CellPlan, times: Times) -> &'static str {
    match times {
        Times::Every if plan.step > 1 => "at every model tick",
        Times::Zones => "at every tick, by zones",
        Times::Every => "at every tick",
        Times::Between => "at the ends of times and after events",
        Times::Ends | Times::Auto => "at the ends of times",
    }
}

fn faults(plan: &CellPlan, hypothesis: usize) -> String {
    let (cell, Some(faults)) = (plan.table.cell(), plan.faults.get(hypothesis)) else { return String::new() };
    let node = |at: usize| cell.nodes.get(at).map_or("?", |node| node.name.as_str());
    let counted = [
        (faults.loss, "packet lost", "packets lost"),
        (faults.dup, "packet doubled", "packets doubled"),
        (faults.reorder, "packet overtaking another", "packets overtaking others"),
        (faults.fail, "action failing", "actions failing"),
        (faults.drift, "tick missed or counted twice", "ticks missed or counted twice"),
    ];
    let mut parts: Vec<String> = Vec::new();
    for (count, one, more) in counted.into_iter().filter(|(count, ..)| *count > 0) {
        parts.push(format!("{count} {}", if count == 1 { one } else { more }));
    }
    parts.extend(faults.crash.iter().map(|at| format!("a crash of {}", node(at.index()))));
    let mut pauses = faults.pause.iter().peekable();
    while let Some(pause) = pauses.next() {
        let mut times = 1;
        while pauses.next_if_eq(&pause).is_some() {
            times += 1;
        }
        let of = pause.node.map_or("any node", |at| node(at.index()));
        let times = if times == 1 { "a pause".to_owned() } else { format!("{times} pauses") };
        parts.push(format!("{times} of {of} of up to {}", count(pause.most.into(), "tick")));
    }
    for link in faults.cut.iter().filter_map(|&at| cell.links.get(at)) {
        parts.push(format!("the link {} -- {} cut once", node(link.a.index()), node(link.b.index())));
    }
    parts.join(", ")
}
