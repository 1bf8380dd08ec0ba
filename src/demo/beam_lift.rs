//! Explains the outcome of the demo `beam-lift`. The demo promises that no arm goes on alone.

use crate::output::{count, span};
use imrs_launch::Fault;
use imrs_launch::script_event::{Did, ScriptEvent};
use imrs_launch::{Outcome, Story};
use imrs_protocol::TaskId;

/// The longest delay, in microseconds, from the stop of one arm to the stop of the other, even on a busy machine. An
/// arm that moves longer than that counts as going on alone.
const ALONE: u64 = 1_000_000;

/// A movement of an arm: when it started, and when it stopped, if it has stopped.
#[derive(Clone, Copy, Debug)]
struct Movement {
    from: u64,
    to: Option<u64>,
}

/// Explains what happened to the lifts.
pub fn explain(story: &Story<'_>) -> Outcome {
    let (Some(left), Some(right)) = (story.task("armL"), story.task("armR")) else {
        return Outcome::default();
    };
    let moves = [movements(story, left), movements(story, right)];
    let mut words = vec![match moves[0].len() {
        0 => "The arms never lifted the beam.".into(),
        n => format!("The arms lifted the beam {}.", times(n)),
    }];
    words.extend(waiting(story));
    let cut = story.faults.iter().find_map(|(at, fault)| match fault {
        Fault::Cut(a, b) => Some((*at, [story.node(*a), story.node(*b)])),
        Fault::Kill(_) | Fault::Restart(_) | Fault::Heal(..) | Fault::Pause(_) | Fault::Resume(_) => None,
    });
    let mut hit = false;
    if let Some((at, [a, b])) = cut {
        words.push(format!("At {} the link between {a} and {b} went dead.", story.at(at)));
        hit = moves.iter().flatten().any(|m| m.from < at && m.to.is_none_or(|to| to > at));
        if hit {
            words.extend([left, right].into_iter().filter_map(|arm| why(story, arm, at)));
        } else {
            words.push("Nothing moved just then, so nothing had to stop. On an idle machine the cut comes in the middle of a lift.".into());
        }
    }
    let alone =
        [(0, left), (1, right)].into_iter().find_map(|(i, arm)| alone(story, &moves[i], &moves[1 - i], arm));
    if let Some(skew) = skew(&moves).filter(|_| alone.is_none()) {
        words.push(apart(story, skew));
    }
    if let Some((at, _)) = cut.filter(|_| hit) {
        words.push(afterwards(story, at));
    }
    let kills = story.faults.iter().any(|(_, fault)| matches!(fault, Fault::Kill(_)));
    let held = if let Some(words_of_it) = alone {
        words.push(words_of_it);
        Some(false)
    } else if moves.iter().all(Vec::is_empty) && !kills {
        None
    } else {
        words.push("Neither arm ever went on alone.".into());
        Some(true)
    };
    Outcome { held, words }
}

/// The movements of an arm: from each end of `start_lift` to the end of the next `stop_now`.
fn movements(story: &Story<'_>, arm: TaskId) -> Vec<Movement> {
    let mut all: Vec<Movement> = Vec::new();
    for did in story.of(arm) {
        let ScriptEvent::Ends { action, .. } = &did.what else { continue };
        match action.as_str() {
            "start_lift" => all.push(Movement { from: did.at, to: None }),
            "stop_now" => {
                if let Some(last) = all.last_mut() {
                    last.to.get_or_insert(did.at);
                }
            }
            _ => {}
        }
    }
    // An arm stops when its node is killed.
    for death in story.deaths(arm) {
        for movement in all.iter_mut().filter(|m| m.from <= death && m.to.is_none_or(|to| to > death)) {
            movement.to = Some(death);
        }
    }
    all
}

/// Says in words why an arm stopped after the instant `at`.
fn why(story: &Story<'_>, arm: TaskId, at: u64) -> Option<String> {
    let after = || story.of(arm).filter(move |did| did.at >= at);
    let begins = |did: &&Did| matches!(&did.what, ScriptEvent::Begins { action, .. } if action == "stop_now");
    let stops = after().find(begins)?;
    let silent = after().take_while(|did| did.at <= stops.at);
    let unanswered = silent.filter(|did| matches!(did.what, ScriptEvent::Unanswered { .. })).last();
    let (name, when) = (story.name(arm), span(stops.at - at));
    let line = stops.line.map(|line| format!(" (line {line})")).unwrap_or_default();
    Some(match unanswered {
        Some(_) => {
            format!("{name} asked `beat` and got TIME_OUT; it began to stop {when} after the cut{line}.")
        }
        None if story.handler(stops).contains("silence") => {
            format!("{name} got no `beat` any more; by itself it began to stop {when} after the cut{line}.")
        }
        None => format!("{name} was told to stop, and began to {when} after the cut{line}."),
    })
}

/// Says in words for how long an arm moved on after its partner had stopped, if it did so.
fn alone(story: &Story<'_>, own: &[Movement], partner: &[Movement], arm: TaskId) -> Option<String> {
    if story.died(arm).is_some() {
        return None;
    }
    let stop_of_partner = |movement: &Movement| {
        let end = movement.to.unwrap_or(story.ended);
        let met =
            partner.iter().filter(|other| other.from < end && other.to.is_none_or(|to| to > movement.from));
        met.filter_map(|other| other.to).max()
    };
    own.iter().find_map(|movement| {
        let stopped = stop_of_partner(movement)?;
        let end = movement.to.unwrap_or(story.ended);
        (end > stopped + ALONE).then(|| {
            let longer = span(end - stopped);
            format!(
                "{} moved on for {longer} after its partner had stopped at {}.",
                story.name(arm),
                story.at(stopped)
            )
        })
    })
}

/// The longest time between the stops of the two arms in one lift.
fn skew(moves: &[Vec<Movement>; 2]) -> Option<u64> {
    let [left, right] = moves;
    let of = |one: &Movement| {
        let to = one.to?;
        let met = right.iter().find(|other| other.from < to && other.to.is_some_and(|end| end > one.from))?;
        Some(met.to?.abs_diff(to))
    };
    left.iter().filter_map(of).max()
}

fn apart(story: &Story<'_>, skew: u64) -> String {
    let words = format!("The arms never stopped more than {} apart", span(skew));
    match story.loaded.within("stop_both") {
        Some(allowed) if skew <= allowed => {
            format!("{words}; check `stop_both` of the cell allows {}.", span(allowed))
        }
        Some(allowed) => format!(
            "{words}. Check `stop_both` of the cell allows {}: this machine was too busy to keep that (--rt helps).",
            span(allowed)
        ),
        None => format!("{words}."),
    }
}

/// Describes what the run counted after the cut.
fn afterwards(story: &Story<'_>, at: u64) -> String {
    let expired: u64 =
        story.summary.nodes.iter().flat_map(|node| node.discards.iter()).filter_map(expired).sum();
    let held: u64 = story.summary.nodes.iter().map(|node| node.cut_off).sum();
    let left = story.task("armL");
    let again =
        left.map(|left| story.when(left, |event| matches!(event, ScriptEvent::Met(_)))).unwrap_or_default();
    let late = match expired {
        0 => "none of them was made up for later".to_owned(),
        n => format!(
            "{} dropped as too old to count",
            if n == 1 { "1 message was".into() } else { format!("{n} messages were") }
        ),
    };
    let gap = format!("The cut took {}; {late}, and nothing of the gap was acted on.", count(held, "packet"));
    match again.iter().find(|met| **met > at) {
        Some(met) => format!("{gap} At {} all three met again.", story.at(*met)),
        None => gap,
    }
}

fn expired((name, count): (&String, &u64)) -> Option<u64> {
    name.starts_with("expired").then_some(*count)
}

/// Describes the nodes that were killed, and the tasks that waited for them no longer than their time_outs.
fn waiting(story: &Story<'_>) -> Vec<String> {
    let mut words = Vec::new();
    for (at, fault) in &story.faults {
        let Fault::Kill(node) = fault else { continue };
        let killed = story.node(*node);
        words.push(format!("At {} node {killed} was killed.", story.at(*at)));
        for after in story.summary.after_kill.iter().filter(|after| after.killed == killed) {
            words.push(format!(
                "{} waited for it at `lift` {}, as long as its time_out says, and went home without a lift.",
                after.task,
                span(after.waited_us)
            ));
        }
    }
    words
}

fn times(n: usize) -> String {
    match n {
        1 => "once".into(),
        2 => "twice".into(),
        n => format!("{n} times"),
    }
}
