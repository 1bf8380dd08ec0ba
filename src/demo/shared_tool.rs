//! Explains the outcome of the demo `shared-tool`. The demo promises that two robots never have the tool at once, and
//! that a killed robot does not keep it.

use crate::output::{count, span};
use imrs_launch::Fault;
use imrs_launch::script_event::ScriptEvent;
use imrs_launch::{Outcome, Story};
use imrs_protocol::TaskId;

/// How much later than the cell declares the tool of a killed robot may become free, in microseconds, because the
/// machine may be busy.
const LATE: u64 = 3_000_000;

/// An interval during which a robot had the tool.
#[derive(Clone, Copy, Debug)]
struct Holding {
    by: TaskId,
    from: u64,
    to: u64,
}

/// Explains which robot had the tool when, and what happened to the tool when its holder was killed.
pub fn explain(story: &Story<'_>) -> Outcome {
    let robots: Vec<TaskId> =
        ["weldA", "weldB", "inspC"].iter().filter_map(|name| story.task(name)).collect();
    let mut held: Vec<Holding> = robots.iter().flat_map(|robot| holdings(story, *robot)).collect();
    held.sort_by_key(|holding| holding.from);
    let mut words = vec![asking(story)];
    words.extend(robots.iter().map(|robot| turns(story, *robot, &held)));
    let died = story.faults.iter().find_map(|(at, fault)| match fault {
        Fault::Kill(node) => Some((*at, *node)),
        Fault::Restart(_) | Fault::Cut(..) | Fault::Heal(..) | Fault::Pause(_) | Fault::Resume(_) => None,
    });
    let of_dead = died.and_then(|(at, node)| {
        let holds = |h: &&Holding| h.to == at && story.loaded.table.location(h.by) == Some(node);
        held.iter().find(holds).copied()
    });
    let mut freed = None;
    if let Some(dead) = of_dead {
        freed = after_death(story, dead, &held, &mut words);
    }
    let two = held.windows(2).find(|pair| pair[1].from < pair[0].to);
    match two {
        Some(pair) => words.push(format!(
            "At {} {} and {} both had the tool.",
            story.at(pair[1].from),
            story.name(pair[0].by),
            story.name(pair[1].by)
        )),
        None => words.push("At no instant had two of them the tool.".into()),
    }
    Outcome { held: if two.is_some() { Some(false) } else { freed }, words }
}

/// The intervals during which a robot had the tool: while it dresses or cleans, and at most until its node is killed.
fn holdings(story: &Story<'_>, robot: TaskId) -> Vec<Holding> {
    let mut all: Vec<Holding> = Vec::new();
    let uses = |action: &str| action == "dress" || action == "clean";
    for did in story.of(robot) {
        match &did.what {
            ScriptEvent::Begins { action, .. } if uses(action) => {
                all.push(Holding { by: robot, from: did.at, to: story.ended });
            }
            ScriptEvent::Ends { action, .. } | ScriptEvent::Fails(action) | ScriptEvent::CutShort(action)
                if uses(action) =>
            {
                if let Some(last) = all.last_mut() {
                    last.to = did.at;
                }
            }
            _ => {}
        }
    }
    for death in story.deaths(robot) {
        for holding in all.iter_mut().filter(|h| h.from <= death && h.to > death) {
            holding.to = death;
        }
    }
    all
}

/// Describes how often the robots asked for the tool, and the outcomes.
fn asking(story: &Story<'_>) -> String {
    let Some(grab) = story.summary.ports.iter().find(|port| port.name == "grab") else {
        return String::new();
    };
    let asked = count(grab.sent, "time");
    match grab.timed_out + grab.refused {
        0 => format!(
            "The robots asked for the tool {asked}, and got yes or no each time, before their time_outs."
        ),
        n => format!("The robots asked for the tool {asked}; {n} of that without an answer."),
    }
}

/// Describes how often a robot had the tool.
fn turns(story: &Story<'_>, robot: TaskId, held: &[Holding]) -> String {
    let had = held.iter().filter(|h| h.by == robot).count();
    format!("{} had it {}.", story.name(robot), count(u64::try_from(had).unwrap_or(u64::MAX), "time"))
}

/// Describes what happened to the tool of a killed robot. Returns whether another robot had the tool in time; `None` if
/// the run ended before that time.
fn after_death(story: &Story<'_>, dead: Holding, held: &[Holding], words: &mut Vec<String>) -> Option<bool> {
    let name = story.name(dead.by);
    words.push(format!("At {} the node of {name} was killed, and {name} had the tool.", story.at(dead.to)));
    let allowed = story.loaded.within("dead_holder").unwrap_or(0);
    let next = held.iter().find(|h| h.from > dead.to);
    match next {
        Some(next) => {
            words.push(format!(
                "It was not brought back. The cell lends it for 4 s: at {}, {} after the death, {} had it.",
                story.at(next.from),
                span(next.from - dead.to),
                story.name(next.by)
            ));
            Some(true)
        }
        None if story.ended > dead.to + allowed + LATE => {
            words.push("No robot had it after that.".into());
            Some(false)
        }
        None => {
            words.push("The run ended before its time was over.".into());
            None
        }
    }
}
