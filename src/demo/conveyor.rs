//! Explains the outcome of the demo `conveyor`. The demo promises that no pick uses an old pose, and that the
//! belt does not jam.

use crate::output::{count, span};
use imrs_launch::script_event::ScriptEvent;
use imrs_launch::{Outcome, Story};
use imrs_protocol::TaskId;

/// The longest time, in microseconds, from the end of the pause to the next grip, even on a busy machine.
const JAMMED: u64 = 3_000_000;

/// Explains how many parts were handed on, and the effect of the camera's suspension.
pub fn explain(story: &Story<'_>) -> Outcome {
    let (Some(pick), Some(place)) = (story.task("pick"), story.task("place")) else {
        return Outcome::default();
    };
    let grips = begins(story, pick, "grip_at");
    let handed = begins(story, place, "put_away").len();
    let boxed = begins(story, pick, "drop_into_box").len();
    // When the run ends, the robot `pick` may still hold a part, and `place` may not have put one away.
    let rest = grips.len().saturating_sub(handed + boxed);
    let on_the_way = match rest {
        0 => String::new(),
        1 => "; 1 was still in the robots' hands when the run ended".into(),
        n => format!("; {n} were still in the robots' hands when the run ended"),
    };
    let mut words = vec![format!(
        "pick took {} from the belt: {handed} went to place, {boxed} into the box{on_the_way}.",
        parts(grips.len()),
    )];
    let mut held = None;
    if let Some((node, from, to)) = story.pause() {
        let length = span(to - from);
        words.push(match story.summary.nodes.iter().find(|n| n.name == story.node(node)) {
            Some(of) if of.cut_off > 0 => {
                let lost = count(of.cut_off, "packet");
                format!(
                    "At {} node {} was cut off for {length}; {lost} of it went nowhere.",
                    story.at(from),
                    of.name
                )
            }
            _ => format!("At {} node {} stood still for {length}.", story.at(from), story.node(node)),
        });
        let next = grips.iter().copied().find(|at| *at > from);
        words.push(waited(story, from, to, next));
        held = match next {
            Some(_) => Some(true),
            None if story.ended > to + JAMMED => Some(false),
            None => None,
        };
        words.push(expired(story));
    }
    if held == Some(true) {
        words.push("The belt did not jam: the robots went on by themselves.".into());
    }
    Outcome { held, words }
}

fn begins(story: &Story<'_>, task: TaskId, name: &str) -> Vec<u64> {
    story.when(task, |event| matches!(event, ScriptEvent::Begins { action, .. } if action == name))
}

fn waited(story: &Story<'_>, from: u64, to: u64, next: Option<u64>) -> String {
    match next {
        Some(at) if at >= to => format!(
            "pick took nothing meanwhile; {} after the camera went on, at {}, it had a new pose and took the next part.",
            span(at - to),
            story.at(at)
        ),
        Some(at) => format!(
            "At {}, {} into that, pick took a part on a pose from before, which still counted.",
            story.at(at),
            span(at - from)
        ),
        None => "After that pick took no part any more.".into(),
    }
}

fn expired(story: &Story<'_>) -> String {
    let pose = story.summary.ports.iter().find(|port| port.name == "pose");
    match pose.map_or(0, |port| port.expired) {
        0 => "No pose became too old in transit.".into(),
        1 => "1 pose became older than 66 ms while pick was busy, and was thrown away.".into(),
        n => format!(
            "{n} poses became older than 66 ms, most of them while pick was busy, and were thrown away."
        ),
    }
}

fn parts(n: usize) -> String {
    count(u64::try_from(n).unwrap_or(u64::MAX), "part")
}
