//! Texts about how far a search came: what it covered. If a budget ended the search, they also say what makes it large,
//! and what would let it end.

use super::subject::Subject;
use crate::output::{count, grouped};
use imrs_model::cell::{CellPlan, Coverage, Phase};

/// If there are this many states for each state that differs in something other than times, the text names times as a reason.
const MANY_TIMES: u64 = 3;

/// What a phase covered, in one line.
pub(super) fn looked_at(phase: &Coverage) -> String {
    let whole = match (&phase.ended_by, phase.pruned) {
        (Some(by), _) => {
            let whole = grouped(phase.whole_depth);
            let share = share(phase);
            format!("cut short, {by}: {share}every order of events was looked at up to its choice {whole}")
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

/// The beginning of a sentence: how many of the found states were explored, too. Empty if all of them were explored.
fn share(phase: &Coverage) -> String {
    let Some(left) = &phase.unfinished else { return String::new() };
    let done = phase.states.saturating_sub(left.open);
    let percent = (done * 100).checked_div(phase.states).unwrap_or(0);
    format!("{} of these states were looked at ({percent} %), and ", grouped(done))
}

/// Sentences that explain a search that stands for more times than can occur, or that is unfinished.
pub(super) fn explained(subject: &Subject, plan: &CellPlan, phase: &Coverage) -> Vec<String> {
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
