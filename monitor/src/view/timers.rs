//! Screen 5: all deadlines, soonest first: each node's timers, and the waits with a time_out.

use super::canvas::{Canvas, Column, bar};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::store::health::Place;
use crate::store::trail::Trail;
use crate::store::{Left, NodeIncarnation};
use crate::theme::Ink;
use imrs_protocol::{Event, PortId, TaskId, TaskState, TimeId};

/// A timer of a node, or a wait of a task.
struct Entry {
    owner: TaskId,
    id: String,
    kind: &'static str,
    /// The full duration of the timer or wait in microseconds; `None` if unknown.
    length_us: Option<u64>,
    left: Left,
    what: String,
}

/// A line of the timer screen.
pub(super) enum Line {
    /// A node and its timers; how late they are.
    Node(String, String, Ink),
    Entry(Box<[(String, Ink); 6]>, Left, Option<u64>),
    Note(&'static str),
}

const COLUMNS: [Column; 7] = [
    Column::left("OWNER", 14),
    Column::left("ID", 5),
    Column::left("KIND", 8),
    Column::right("LENGTH", 7),
    Column::right("LEFT", 7),
    Column::left("TIME LEFT", 22),
    Column::left("WHAT", 0),
];

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let (lines, opens): (Vec<_>, Vec<_>) =
        lines(app, now).into_iter().map(|(line, place)| (line, place.map(Hit::Place))).unzip();
    let room = usize::from(canvas.height().saturating_sub(1));
    let (window, selected) = canvas.chosen(app.scroll, room, opens);
    let canvas = &mut canvas.beside_scrollbar(1, window);
    let width = canvas.area.width;
    let shown: &[usize] = match width {
        0..60 => &[0, 2, 4, 6],
        60..100 => &[0, 1, 2, 3, 4, 5],
        _ => &[0, 1, 2, 3, 4, 5, 6],
    };
    let mut columns: Vec<Column> = shown.iter().map(|&i| COLUMNS[i]).collect();
    for column in &mut columns {
        column.width = match (column.title, width) {
            ("OWNER", 0..60) => 10,
            ("TIME LEFT", 60..100) => 0,
            ("TIME LEFT", 160..) => 42,
            _ => column.width,
        };
    }
    let widths = canvas.indented().widths(&columns);
    canvas.indented().titles(0, &columns, &widths);
    canvas.corner(0, &[vec![window.position(selected)]], Ink::Head);
    for (y, (at, line)) in (1..).zip(lines.iter().enumerate().skip(window.first).take(room)) {
        let mut inner = canvas.indented();
        match line {
            Line::Node(text, late, ink) => inner.line(y, &[(text, *ink), (late, *ink)]),
            Line::Note(text) => inner.line(y, &[("  ", Ink::Plain), (text, Ink::Dim)]),
            Line::Entry(cells, left, length) => {
                let at = shown.iter().position(|&i| i == 5);
                let room = at.map_or(0, |at| widths[at].saturating_sub(2).min(40));
                let drawn = length.map_or_else(String::new, |length| {
                    format!("[{}]", bar(&app.theme, room, left.us, length))
                });
                let ink = if cells[4].1 == Ink::Plain { Ink::Bar } else { cells[4].1 };
                let all: [(&str, Ink); 7] = std::array::from_fn(|i| match i {
                    5 => (drawn.as_str(), ink),
                    6 => (cells[5].0.as_str(), cells[5].1),
                    _ => (cells[i].0.as_str(), cells[i].1),
                });
                let cells: Vec<_> = shown.iter().map(|&i| all[i]).collect();
                inner.row(y, &columns, &widths, &cells);
            }
        }
        canvas.line_of(y, at, selected);
    }
}

/// All lines of the screen. For each line, the node or task that it is about.
fn lines(app: &App, now: Moment) -> Vec<(Line, Option<Place>)> {
    let Some(cell) = app.cell() else { return Vec::new() };
    let store = app.store();
    let mut lines = Vec::new();
    for incarnation in store.present(&cell) {
        let gone = incarnation.presence(now).is_gone();
        let timers = incarnation.last.as_ref().map_or(0, |s| s.snapshot.timers.len());
        let presence = if gone { format!("  {}", incarnation.presence(now)) } else { String::new() };
        let (late, is_late) = lateness(incarnation);
        let ink = match (gone, is_late) {
            (true, _) => Ink::Dim,
            (false, true) => Ink::Warn,
            (false, false) => Ink::Head,
        };
        let place = Place { node: Ok(incarnation.id), task: None, port: None };
        let text = format!("{}{presence}  Timer: {timers} running", incarnation.node);
        lines.push((Line::Node(text, format!("  {late}"), ink), Some(place)));
        let mut entries = entries(incarnation, store.trail(), now);
        entries.sort_by_key(|entry| (entry.left.us, entry.owner));
        if entries.is_empty() {
            lines.push((Line::Note("nothing runs out here"), Some(place)));
        }
        let of = |entry: Entry| {
            let place = Place { task: Some(entry.owner), ..place };
            (line(incarnation, entry, gone), Some(place))
        };
        lines.extend(entries.into_iter().map(of));
    }
    lines
}

/// A text about the lateness of the node's Timer, if the node has reported it.
fn lateness(incarnation: &NodeIncarnation) -> (String, bool) {
    let Some(told) = &incarnation.vitals else { return ("late: -".to_owned(), false) };
    let timer = told.what.timer;
    let us = Span::micros;
    let text = format!(
        "late: p50 {} p99 {} max {}; {} of {} past the tick",
        us(timer.p50_us),
        us(timer.p99_us),
        us(timer.max_us),
        timer.late,
        timer.count
    );
    (text, timer.late > 0)
}

fn line(incarnation: &NodeIncarnation, entry: Entry, gone: bool) -> Line {
    let tight = entry.length_us.is_some_and(|length| entry.left.us < length / 10);
    let ink = match (gone, entry.left.us, tight) {
        (true, _, _) => Ink::Dim,
        // A delay or timer is meant to expire. For a wait, expiring is a bad sign.
        (false, 0, _) if entry.kind != "timer" && entry.kind != "delay" => Ink::Bad,
        (false, _, true) if entry.kind != "timer" && entry.kind != "delay" => Ink::Warn,
        (false, _, _) => Ink::Plain,
    };
    let plain = if gone { Ink::Dim } else { Ink::Plain };
    let length = entry.length_us.map_or_else(|| "-".to_owned(), |us| Span::micros(us).to_string());
    let left = if entry.left.us == 0 { "over".to_owned() } else { entry.left.to_string() };
    let cells = [
        (incarnation.names.task(entry.owner).to_string(), plain),
        (entry.id, Ink::Dim),
        (entry.kind.to_owned(), plain),
        (length, Ink::Dim),
        (left, ink),
        (entry.what, Ink::Dim),
    ];
    Line::Entry(Box::new(cells), entry.left, entry.length_us)
}

fn entries(incarnation: &NodeIncarnation, trail: &Trail, now: Moment) -> Vec<Entry> {
    let mut found = Vec::new();
    let Some(last) = &incarnation.last else { return found };
    let timers = &last.snapshot.timers;
    for timer in timers {
        // In scripts and in programs, the id of a task's delay is higher than the ids of its timers.
        let of_owner = timers.iter().filter(|t| t.owner == timer.owner);
        let last_name = of_owner.map(|t| t.id).max() == Some(timer.id);
        let delays = incarnation.task(timer.owner).is_some_and(|t| t.view.state == TaskState::Delaying);
        let delay = timer.id >= TimeId(128) || (delays && last_name);
        found.push(Entry {
            owner: timer.owner,
            // The number of a delay is the runtime's own; no cell names it.
            id: if delay { "-".to_owned() } else { format!("t{}", timer.id.0) },
            kind: if delay { "delay" } else { "timer" },
            length_us: incarnation.longest_timer(timer.owner, timer.id),
            left: incarnation.left(timer.remaining, 0, now),
            what: if delay { "the task goes on" } else { "its handler begins" }.to_owned(),
        });
    }
    for task in incarnation.tasks() {
        let owner = task.view.task;
        let whole = |port: PortId| {
            let time_out = incarnation.names.port(port).and_then(|info| info.time_out(owner));
            time_out.map(|t| t.0.saturating_mul(incarnation.tick_us))
        };
        let mut add = |id: String, kind, length_us, remaining, what| {
            let left = incarnation.left(remaining, task.age_us, now);
            found.push(Entry { owner, id, kind, length_us, left, what });
        };
        match task.view.state {
            TaskState::Receiving { port, remaining: Some(remaining) } => {
                let at = port
                    .map_or_else(|| "any port".to_owned(), |p| incarnation.names.port_name(p).to_string());
                add("-".to_owned(), "receive", None, remaining, format!("a message at {at}"));
            }
            TaskState::AwaitingReply { port, from, remaining } => {
                let number = trail.last_number(incarnation.id, owner, Event::Sent, port);
                let id = number.map_or_else(|| "-".to_owned(), |n| format!("#{n}"));
                let what = format!(
                    "the answer to {} from {}",
                    incarnation.names.port_name(port),
                    incarnation.names.task(from)
                );
                add(id, "reply", whole(port), remaining, what);
            }
            TaskState::Waiting { port, round, remaining } => {
                let what = format!("the others at {}", incarnation.names.port_name(port));
                add(round.to_string(), "waitfor", whole(port), remaining, what);
            }
            TaskState::Running | TaskState::Delaying | TaskState::Receiving { remaining: None, .. } => {}
        }
    }
    found
}
