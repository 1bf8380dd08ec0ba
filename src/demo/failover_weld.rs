//! Explains the outcome of the demo `failover-weld`. The demo promises that the two robots are never both active, and
//! that no spot is welded twice without an inspection before the second time.

use crate::output::span;
use imrs_launch::Fault;
use imrs_launch::checks::Settled;
use imrs_launch::script_event::{Lease, ScriptEvent};
use imrs_launch::{Outcome, Story};
use imrs_protocol::TaskId;

/// Explains which robot was active when, and what happened to the interrupted spot.
pub fn explain(story: &Story<'_>) -> Outcome {
    let couple = story.loaded.table.cell().couples.first().cloned();
    let Some(couple) = couple else { return Outcome::default() };
    let (primary, standby) = (couple.primary, couple.standby);
    let (first, second) = (story.name(primary), story.name(standby));
    let in_words = |(at, fault): &(u64, Fault)| Some((*at, fault_in_words(story, *at, *fault, primary)?));
    let mut told: Vec<(u64, String)> = story.faults.iter().filter_map(in_words).collect();
    let fenced = story.when(primary, |event| *event == ScriptEvent::Lease(Lease::Fenced));
    told.extend(fenced.first().map(|at| {
        let when = story.at(*at);
        (*at, format!("At {when} the lease of {first} ran out, because it was not renewed: {first} acts no more, whether it can be reached or not."))
    }));
    let taken = story.when(standby, |event| *event == ScriptEvent::Lease(Lease::TookOver)).first().copied();
    told.extend(taken.map(|at| (at, taking_over(story, &couple, at))));
    told.sort_by_key(|(at, _)| *at);
    let mut words: Vec<String> = told.into_iter().map(|(_, words)| words).collect();
    if taken.is_none() {
        words.push(format!("{second} never took over: it got answers to its heartbeats all the time."));
    }
    if let Some(at) = taken {
        words.push(spot_in_words(story, primary, standby, at));
    }
    // This uses the cell's own check: it takes the end of a lease on time, even if a suspended node notices that end late.
    let one_active = story.summary.checks.named("one_active");
    let twice = welded_twice(story, primary, standby);
    let killed = story.died(primary).is_some_and(|at| at + 2 * couple.takeover.0 < story.ended);
    let stranded = killed && taken.is_none();
    let is_one = one_active.and_then(Settled::held);
    words.push(match is_one {
        Some(true) => "At no instant were both robots active.".into(),
        Some(false) => {
            let at = one_active.and_then(Settled::broke_at).unwrap_or_default();
            format!("At {at:.3} s both robots were active.")
        }
        None => "It is unknown whether both robots were active at one instant: see the check.".into(),
    });
    words.extend(
        twice.iter().map(|spot| format!("Spot {spot} was welded twice, without a look at it between.")),
    );
    if stranded {
        words.push(format!("{first} is gone, and {second} did not take over."));
    }
    let bad = is_one == Some(false) || twice.is_some() || stranded;
    let tested = taken.is_some() || !fenced.is_empty();
    Outcome { held: if bad { Some(false) } else { is_one.filter(|_| tested) }, words }
}

fn fault_in_words(story: &Story<'_>, at: u64, fault: Fault, primary: TaskId) -> Option<String> {
    let when = story.at(at);
    match fault {
        Fault::Kill(node) if story.loaded.table.location(primary) == Some(node) => {
            let during = under_way(story, primary, at);
            let during = during.map(|action| format!(", in the middle of `{action}`")).unwrap_or_default();
            Some(format!("At {when} the node of {} was killed{during}.", story.name(primary)))
        }
        Fault::Kill(node) => Some(format!("At {when} node {} was killed.", story.node(node))),
        Fault::Restart(node) => Some(format!("At {when} node {} was started again.", story.node(node))),
        Fault::Cut(a, b) => {
            Some(format!("At {when} the link between {} and {} went dead.", story.node(a), story.node(b)))
        }
        Fault::Pause(node) => Some(format!("At {when} node {} stood still.", story.node(node))),
        Fault::Heal(..) | Fault::Resume(_) => None,
    }
}

/// The action that a task was executing at an instant, as text: `weld 3`.
fn under_way(story: &Story<'_>, task: TaskId, at: u64) -> Option<String> {
    let mut last = story.of(task).filter(|did| did.at <= at).filter(|did| {
        matches!(
            did.what,
            ScriptEvent::Begins { .. }
                | ScriptEvent::Ends { .. }
                | ScriptEvent::Fails(_)
                | ScriptEvent::CutShort(_)
        )
    });
    match &last.next_back()?.what {
        ScriptEvent::Begins { action, arguments } => {
            Some(format!("{action} {}", arguments.join(" ")).trim_end().into())
        }
        _ => None,
    }
}

fn taking_over(story: &Story<'_>, couple: &imrs_protocol::CoupleDecl, at: u64) -> String {
    let (first, second) = (story.name(couple.primary), story.name(couple.standby));
    let since = story.died(couple.primary).filter(|died| *died <= at);
    let since = since.map(|died| format!(", {} after the death", span(at - died))).unwrap_or_default();
    format!(
        "{second} got no answer to its heartbeats and took over at {}{since}. The cell has it wait {} for the last answer; the lease of {first} ends after {}, so {first} has stopped by then.",
        story.at(at),
        span(couple.takeover.0),
        span(couple.lease.0)
    )
}

/// Describes what happened to the spot that the first robot was welding when the second one took over.
fn spot_in_words(story: &Story<'_>, primary: TaskId, standby: TaskId, taken: u64) -> String {
    let open = under_way(story, primary, taken);
    let next = story.of(standby).filter(|did| did.at >= taken).find_map(|did| match &did.what {
        ScriptEvent::Begins { action, arguments } => Some(format!("{action} {}", arguments.join(" "))),
        _ => None,
    });
    let (first, second) = (story.name(primary), story.name(standby));
    match (open, next) {
        (Some(open), Some(next)) if next.starts_with("recheck") => format!(
            "{first} had reported to {second} that it was at work on a spot (`{open}`). So {second} began with `{}`: the spot is looked at, not welded a second time unseen.",
            next.trim_end()
        ),
        (Some(open), Some(next)) => {
            format!("{first} had begun `{open}`; {second} went on with `{}`.", next.trim_end())
        }
        (None, Some(next)) => format!("{second} went on with `{}`.", next.trim_end()),
        (_, None) => format!("{second} had begun nothing yet when the run ended."),
    }
}

/// A spot that the first robot finished, and that the second robot welded again without an inspection.
fn welded_twice(story: &Story<'_>, primary: TaskId, standby: TaskId) -> Option<String> {
    let done = welded(story, primary);
    let mut looked_at: Vec<String> = Vec::new();
    for did in story.of(standby) {
        let ScriptEvent::Begins { action, arguments } = &did.what else { continue };
        let spot = arguments.join(" ");
        match action.as_str() {
            "recheck" => looked_at.push(spot),
            "weld" if done.contains(&spot) && !looked_at.contains(&spot) => return Some(spot),
            _ => {}
        }
    }
    None
}

/// The spots that a robot has finished.
fn welded(story: &Story<'_>, robot: TaskId) -> Vec<String> {
    let (mut done, mut open) = (Vec::new(), None);
    for did in story.of(robot) {
        match &did.what {
            ScriptEvent::Begins { action, arguments } if action == "weld" => open = Some(arguments.join(" ")),
            ScriptEvent::Ends { action, .. } if action == "weld" => done.extend(open.take()),
            ScriptEvent::CutShort(action) | ScriptEvent::Fails(action) if action == "weld" => open = None,
            _ => {}
        }
    }
    done
}
