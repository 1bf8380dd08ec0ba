//! Explains the outcome of the demo `belt-administrator`. The demo promises that two robots never both change the speed
//! from the same old value.

use crate::output::count;
use imrs_launch::script_event::{Did, ScriptEvent};
use imrs_launch::{Outcome, Story};
use imrs_protocol::TaskId;

/// The greatest change of the speed in one step, in mm/s.
const STEP: i64 = 100;
/// Two requests that are at most this far apart, in microseconds, belong to one period.
const TOGETHER: u64 = 10_000;

/// Explains how the speed changed, and what happened when two robots wanted to change it at once.
pub fn explain(story: &Story<'_>) -> Outcome {
    let (Some(administrator), Some(slower), Some(faster)) =
        (story.task("administrator"), story.task("r1"), story.task("r2"))
    else {
        return Outcome::default();
    };
    let speeds: Vec<(u64, i64)> =
        story.of(administrator).filter_map(|did| Some((did.at, argument(did, "drive")?))).collect();
    let changes = speeds.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
    let robots = [slower, faster].map(|robot| {
        (
            answers(story, robot, "adapt").len(),
            answers(story, robot, "give_way").len(),
            story.name(robot).to_owned(),
        )
    });
    let mut words = vec![format!("The belt changed its speed {}.", times(changes))];
    for (won, lost, name) in &robots {
        words.push(format!(
            "{name} changed it {}, and gave way {}: the other was first, or the belt at its limit.",
            times(*won),
            times(*lost)
        ));
    }
    let together = together(story, slower, faster);
    words.extend(together.clone());
    let jump = speeds.windows(2).find(|pair| (pair[0].1 - pair[1].1).abs() > STEP);
    match jump {
        Some(pair) => words.push(format!(
            "At {} the belt went from {} to {} mm/s in one step: two changes were made of one version.",
            story.at(pair[1].0),
            pair[0].1,
            pair[1].1
        )),
        None => words.push("No version of the speed was changed twice.".into()),
    }
    let held = if jump.is_some() { Some(false) } else { together.map(|_| true) };
    Outcome { held, words }
}

/// The argument of the action `name`, if this event is the beginning of that action.
fn argument(did: &Did, name: &str) -> Option<i64> {
    match &did.what {
        ScriptEvent::Begins { action, arguments } if action == name => arguments.first()?.parse().ok(),
        _ => None,
    }
}

fn answers(story: &Story<'_>, robot: TaskId, action: &str) -> Vec<(u64, i64)> {
    story.of(robot).filter_map(|did| Some((did.at, argument(did, action)?))).collect()
}

/// Describes the first period in which one robot changed the speed and the other one gave way.
fn together(story: &Story<'_>, slower: TaskId, faster: TaskId) -> Option<String> {
    let pairs = [(slower, faster), (faster, slower)].into_iter().flat_map(|(first, second)| {
        let gave_way = answers(story, second, "give_way");
        answers(story, first, "adapt").into_iter().filter_map(move |(at, speed)| {
            let other =
                gave_way.iter().find(|(other, told)| at.abs_diff(*other) < TOGETHER && *told == speed)?;
            Some((at.max(other.0), first, second, speed))
        })
    });
    let (at, first, second, speed) = pairs.min_by_key(|pair| pair.0)?;
    let (first, second) = (story.name(first), story.name(second));
    Some(format!(
        "At {} both had asked for another speed, naming the same version: {first} was first, and the belt runs at {speed} mm/s; {second} got this answer, and gave way.",
        story.at(at)
    ))
}

fn times(n: usize) -> String {
    count(u64::try_from(n).unwrap_or(u64::MAX), "time")
}
