//! Screen 2b: the history of one message, stage by stage, with the time that each stage took.

use super::canvas::{Canvas, Column, bar, columns};
use super::rendezvous::place_of;
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::store::Names;
use crate::store::health::Place;
use crate::store::message::{MessageKey, Passed, Stage, stages_of};
use crate::store::queue::{Waiting, queue};
use crate::store::timeline::own_clock;
use crate::theme::Ink;
use imrs_protocol::Event;
use ratatui::layout::Rect;
use std::time::Duration;

const COLUMNS: [Column; 8] = [
    Column::right("AT", 10),
    Column::left("WHERE", 16),
    Column::left("WHAT", 18),
    Column::right("LEFT", 7),
    Column::right("CHARGED", 8),
    Column::right("CLOCKS", 8),
    Column::left("SINCE", 16),
    Column::left("TIME LEFT", 0),
];

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let Some((cell, key)) = app.cell().zip(app.message()) else {
        let text =
            " No message is chosen: press Enter on one in a port's queue (2), the events or the timeline.";
        canvas.line(1, &[(text, Ink::Plain)]);
        return;
    };
    let Some(names) = app.store().names(&cell).cloned() else { return };
    let stages = stages_of(app.store(), &cell, key);
    let whole_us = whole(app, &names, key, &stages);
    about(app, &names, key, whole_us, canvas);
    let rows = u16::try_from(stages.len()).unwrap_or(u16::MAX);
    if stages.is_empty() {
        let text = " Its history is gone: it was sent before the monitor attached, or too long ago.";
        canvas.line(2, &[(text, Ink::Dim)]);
    } else {
        table(app, &names, &stages, whole_us, &mut canvas.below(2));
    }
    let mut rest = canvas.below(rows.saturating_add(4).max(4));
    let mut lines: Vec<_> =
        sentence(&stages, rest.area.width).into_iter().map(|(text, ink)| (text, ink, None)).collect();
    lines.extend(waiting(app, &names, key, now));
    for (y, (text, ink, place)) in (0..).zip(&lines) {
        rest.facts(y, &[(text, *ink, place.map(Hit::Place))]);
    }
}

/// The TTL of the message in microseconds: the TTL with which it was sent or, if that is unknown, the time_out that its
/// source declares on the port.
fn whole(app: &App, names: &Names, key: MessageKey, stages: &[Stage]) -> u64 {
    let sent = stages.iter().find(|s| s.mark.seen.what.event == Event::Sent).map(|s| s.left_us);
    let tick_us = app.incarnation_of_task(key.source).map_or(1, |incarnation| incarnation.tick_us);
    let declared = names.port(key.port).and_then(|info| info.time_out(key.source));
    let declared = declared.map_or(0, |ticks| ticks.0.saturating_mul(tick_us));
    let most = stages.iter().map(|s| s.left_us).max().unwrap_or(0);
    sent.unwrap_or(declared).max(most)
}

fn about(app: &App, names: &Names, key: MessageKey, whole_us: u64, canvas: &mut Canvas<'_>) {
    let home = |task| names.home(task).map_or_else(String::new, |node| format!("@{}", names.node(node)));
    let name = format!(" {}#{}", names.port_name(key.port), key.number);
    let source = format!("  of {}{}", names.task(key.source), home(key.source));
    let info = names.port(key.port);
    let class = match info.map(|info| info.class) {
        Some(imrs_protocol::Class::Command) => "  class 2",
        Some(imrs_protocol::Class::Status) => "  class 1",
        None => "",
    };
    let incarnation = format!("  TTL {}", Span::micros(whole_us));
    let task = place_of(app, &names.cell, key.source);
    let port = task.map(|task| Place { port: task.task.map(|_| key.port), ..task });
    canvas.facts(
        0,
        &[
            (&name, Ink::Head, port.map(Hit::Place)),
            (&source, Ink::Plain, task.map(Hit::Place)),
            (class, Ink::Dim, None),
            (&incarnation, Ink::Plain, None),
        ],
    );
}

fn table(app: &App, names: &Names, stages: &[Stage], whole_us: u64, canvas: &mut Canvas<'_>) {
    let width = canvas.area.width;
    let shown: &[usize] = match width {
        0..60 => &[1, 2, 3, 4],
        60..110 => &[0, 1, 2, 3, 4, 5, 7],
        _ => &[0, 1, 2, 3, 4, 5, 6, 7],
    };
    let mut columns: Vec<Column> = shown.iter().map(|&i| COLUMNS[i]).collect();
    if width < 60 {
        (columns[0].width, columns[1].width) = (10, 10);
    } else if width < 110 {
        (columns[1].width, columns[2].width) = (12, 12);
    }
    // A narrow table needs a free column for the cursor. In a wide table the first column begins with spaces anyway.
    let indent = u16::from(width < 60);
    let inner = |canvas: &Canvas<'_>| Rect {
        x: canvas.area.x + indent.min(canvas.area.width),
        width: canvas.area.width.saturating_sub(indent),
        ..canvas.area
    };
    let area = inner(canvas);
    let widths = canvas.part(area).widths(&columns);
    canvas.part(area).titles(0, &columns, &widths);
    let bar_width = widths.last().map_or(0, |w| w.saturating_sub(2).min(60));
    let room = usize::from(canvas.height().saturating_sub(1));
    // All rows use the clock of one node. The nodes' own clocks have different origins, so their times would not be in order.
    let first = stages.first().and_then(|stage| app.store().incarnation(stage.mark.incarnation));
    let (window, selected) = canvas.chosen(app.scroll, room, stages.iter().map(place).collect());
    let canvas = &mut canvas.beside_scrollbar(1, window);
    for (y, (number, stage)) in (1..).zip(stages.iter().enumerate().skip(window.first).take(room)) {
        let event = stage.mark.seen.what.event;
        let ink = super::words::ink(event);
        let incarnation = app.store().incarnation(stage.mark.incarnation);
        let at = first.and_then(|first| own_clock(first, stage.mark.at)).map_or_else(String::new, clock);
        let node = incarnation.map_or_else(String::new, |incarnation| incarnation.node.to_string());
        let place = if stage.mark.in_transit {
            "transit".to_owned()
        } else {
            names.task(stage.mark.task).to_string()
        };
        let what = word(event);
        let left = Span::micros(stage.left_us).to_string();
        let charged = stage.charged_us.map_or_else(|| "-".to_owned(), minus);
        let clocks = stage.passed.map_or_else(|| "-".to_owned(), clocks);
        let since = stage.after.and_then(|at| stages.get(at)).map_or("", |s| word(s.mark.seen.what.event));
        let bar = format!("[{}]", bar(&app.theme, bar_width, stage.left_us, whole_us));
        let place = format!("{place}@{node}");
        let tight = stage.left_us < whole_us / 10;
        let left_ink = if tight { Ink::Warn } else { Ink::Plain };
        let all = [
            (at.as_str(), Ink::Dim),
            (place.as_str(), Ink::Plain),
            (what, ink),
            (left.as_str(), left_ink),
            (charged.as_str(), Ink::Plain),
            (clocks.as_str(), Ink::Dim),
            (since, Ink::Dim),
            (bar.as_str(), if tight { Ink::Warn } else { Ink::Bar }),
        ];
        let cells: Vec<_> = shown.iter().map(|&i| all[i]).collect();
        let area = inner(canvas);
        canvas.part(area).row(y, &columns, &widths, &cells);
        canvas.line_of(y, number, selected);
    }
}

/// The place of a stage: the port at its task, or the node whose transit buffer has the message.
fn place(stage: &Stage) -> Option<Hit> {
    let mark = &stage.mark;
    let task = (!mark.in_transit).then_some(mark.task);
    let port = task.map(|_| mark.seen.what.port);
    Some(Hit::Place(Place { node: Ok(mark.incarnation), task, port }))
}

fn clock(us: u64) -> String {
    let at = Duration::from_micros(us);
    format!("{}:{:02}.{:03}", at.as_secs() / 60 % 60, at.as_secs() % 60, at.subsec_millis())
}

fn minus(us: u64) -> String {
    format!("-{}", Span::micros(us))
}

fn clocks(passed: Passed) -> String {
    let sign = if passed.estimated { "~" } else { "" };
    format!("{sign}{}", Span::micros(passed.us))
}

/// The name of a stage, in one or two words.
const fn word(event: Event) -> &'static str {
    match event {
        Event::Discarded(reason) => reason.name(),
        Event::RefusedByPeer => "refused by peer",
        Event::TimedOutUnsent => "timed out unsent",
        Event::PeerRestarted => "peer restarted",
        Event::Rejected => "rejected by rank",
        Event::Resent => "sent again",
        other => crate::store::journal::word(other),
    }
}

/// The whole history as one sentence, wrapped at `width`.
fn sentence(stages: &[Stage], width: u16) -> Vec<(String, Ink)> {
    let part = |stage: &Stage| {
        let event = word(stage.mark.seen.what.event);
        let left = Span::micros(stage.left_us);
        match (stage.mark.seen.what.event, stage.charged_us) {
            (Event::Sent, _) => format!("sent with {left}"),
            (Event::Delivered, Some(us)) => format!("{event} with {left} (-{} waiting)", Span::micros(us)),
            (_, Some(us)) => format!("{event} with {left} (-{})", Span::micros(us)),
            (_, None) => format!("{event} with {left}"),
        }
    };
    let mut lines = vec![(" ".to_owned(), Ink::Plain)];
    for (i, stage) in stages.iter().enumerate() {
        let text = part(stage) + if i + 1 < stages.len() { "; " } else { "." };
        let last = lines.len() - 1;
        if columns(&lines[last].0).saturating_add(columns(&text)) > width && lines[last].0.len() > 1 {
            lines.push((format!(" {text}"), Ink::Plain));
        } else {
            lines[last].0 += &text;
        }
    }
    lines
}

/// The place where the message is queued now, as text.
fn waiting(app: &App, names: &Names, key: MessageKey, now: Moment) -> Option<(String, Ink, Option<Place>)> {
    let cell = app.cell()?;
    for incarnation in app.store().incarnations_of(&cell) {
        for task in incarnation.tasks().iter().map(|task| task.view.task) {
            let waiting = queue(incarnation, task, key.port, now);
            let fits = |w: &&Waiting| {
                let id = w.entry.id;
                let is_its = key.incarnation.is_none_or(|incarnation| incarnation == id.incarnation);
                is_its && w.entry.source == key.source && id.sequence.get() == key.number
            };
            if let Some(found) = waiting.iter().find(fits) {
                let left = found.left;
                let back_off = match found.back_off_us {
                    0 => String::new(),
                    us => format!(", not offered for {}", Span::micros(us)),
                };
                let text = format!(
                    " now it waits at {}@{}: {left} left{back_off}.",
                    names.task(task),
                    incarnation.node
                );
                let place = Place { node: Ok(incarnation.id), task: Some(task), port: Some(key.port) };
                return Some((text, if left.us == 0 { Ink::Bad } else { Ink::Good }, Some(place)));
            }
        }
    }
    None
}
