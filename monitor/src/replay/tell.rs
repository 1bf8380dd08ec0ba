//! Prints the position in a recording, as text and as JSON.

use super::{Player, Trouble};
use crate::name::shown_line;
use crate::store::{NodeIncarnation, Presence};
use imrs_protocol::TaskId;
use imrs_wire::recording::Story;
use serde::Serialize;
use std::fmt::Write as _;

/// The position in a recording, as JSON.
#[derive(Serialize)]
pub(crate) struct Position<'a> {
    /// The index of the shown stop, and the number of stops.
    stop: usize,
    stops: usize,
    at_us: u64,
    /// For a counterexample: the ticks since its start.
    tick: Option<u64>,
    odd: bool,
    happened: &'a [String],
    tasks: Vec<Doing<'a>>,
    story: Option<StoryShown<'a>>,
    /// A note on the file: that it is cut off or damaged.
    notice: Option<&'a str>,
}

#[derive(Serialize)]
struct Doing<'a> {
    task: u16,
    line: Option<u32>,
    does: &'a str,
}

#[derive(Serialize)]
struct StoryShown<'a> {
    file: &'a str,
    kind: &'a str,
    cause: &'a str,
    line: Option<u32>,
    column: Option<u32>,
    text: Option<&'a str>,
    bounds: &'a str,
    tick_us: u64,
    steps: u32,
}

/// The position of `player`, to be printed as JSON.
pub(crate) fn position(player: &Player) -> Position<'_> {
    let film = player.film();
    let step = player.step();
    let tasks = step.map_or(&[][..], |step| &step.tasks).iter();
    let story = film.story.as_ref().map(|story| StoryShown {
        file: &story.file,
        kind: &story.kind,
        cause: &story.cause,
        line: story.place.as_ref().map(|place| place.line),
        column: story.place.as_ref().map(|place| place.column),
        text: story.place.as_ref().map(|place| place.text.as_str()),
        bounds: &story.bounds,
        tick_us: story.tick_us,
        steps: story.steps,
    });
    Position {
        stop: player.stop(),
        stops: film.stops().len(),
        at_us: crate::clock::micros(player.moment()),
        tick: step.map(|step| step.tick),
        odd: player.trouble() > Trouble::None,
        happened: step.map_or(&[], |step| &step.happened),
        tasks: tasks.map(|doing| Doing { task: doing.task.0, line: doing.line, does: &doing.text }).collect(),
        story,
        notice: film.notice.as_deref(),
    }
}

/// The position of `player` and the events at it, one fact per line.
pub(crate) fn text(player: &Player) -> String {
    format!("replay at {}\n{}{}", player.position(), story(player), happened(player))
}

/// The step that `player` shows, one fact per line: its events, and the activities of tasks and the queues after it.
pub(crate) fn step(player: &Player) -> String {
    let odd = if player.trouble() > Trouble::None { "  !" } else { "" };
    format!("step {}{odd}\n{}{}", player.position(), happened(player), queues(player))
}

/// What a recording shows, one fact per line.
pub(crate) fn story(player: &Player) -> String {
    let film = player.film();
    let mut out = String::new();
    if let Some(notice) = &film.notice {
        let _ = writeln!(out, "  note: {}", shown_line(notice));
    }
    if let Some(story) = &film.story {
        let _ = writeln!(out, "  finding: {}", cause(story));
        if let Some(place) = place(story) {
            let _ = writeln!(out, "  at {place}");
        }
        let _ = writeln!(out, "  searched: {}", shown_line(&story.bounds));
    }
    out
}

fn happened(player: &Player) -> String {
    let mut out = String::new();
    for text in player.step().map_or(&[][..], |step| &step.happened) {
        let _ = writeln!(out, "  happened: {}", shown_line(text));
    }
    for (_, text) in tasks(player) {
        let _ = writeln!(out, "  {text}");
    }
    out
}

/// The queues of tasks, and the transit buffers of running nodes, that are not empty.
fn queues(player: &Player) -> String {
    let mut out = String::new();
    let up = |incarnation: &&NodeIncarnation| {
        matches!(incarnation.presence(player.moment()), Presence::Up | Presence::Silent(_))
    };
    for incarnation in player.store().incarnations().iter().filter(up) {
        let Some(sample) = &incarnation.last else { continue };
        for task in &sample.snapshot.tasks {
            let name = incarnation.names.task(task.view.task);
            for port in task.view.ports.iter().filter(|port| port.len > 0) {
                let at = incarnation.names.port_name(port.port);
                let _ = writeln!(out, "  {name} has {} of {} waiting in {at}", port.len, port.capacity);
            }
        }
        let transit = &sample.snapshot.transit;
        if transit.len > 0 {
            let (node, len, capacity) = (&incarnation.node, transit.len, transit.capacity);
            let _ = writeln!(out, "  node {node} has {len} of {capacity} in transit");
        }
    }
    out
}

/// The activity of each task after the shown step, with the line of its statement.
pub(crate) fn tasks(player: &Player) -> impl Iterator<Item = (TaskId, String)> {
    let names = player
        .store()
        .incarnations()
        .iter()
        .map(|incarnation| &incarnation.names)
        .max_by_key(|names| names.tasks.len());
    player.step().map_or(&[][..], |step| &step.tasks).iter().map(move |doing| {
        let name = names.map_or_else(String::new, |names| names.task(doing.task).to_string());
        let line = doing.line.map_or_else(String::new, |line| format!(", line {line}"));
        (doing.task, format!("{name}{line}: {}", shown_line(&doing.text)))
    })
}

/// The finding of a counterexample, in one line.
pub(crate) fn cause(story: &Story) -> String {
    format!("{}: {}", shown_line(&story.kind), shown_line(&story.cause))
}

/// The place of the finding in the cell's file.
pub(crate) fn place(story: &Story) -> Option<String> {
    let place = story.place.as_ref()?;
    let first = place.text.lines().next().unwrap_or_default();
    Some(format!("{}:{}:{}  {}", shown_line(&story.file), place.line, place.column, shown_line(first)))
}
