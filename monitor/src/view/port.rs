//! Screen 2: the messages that wait at one port, in the order they will be served, and how long each still has.

use super::Hit;
use super::pen::{Column, Pen, bar, first_row};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::store::{Life, PortInfo};
use crate::theme::Ink;
use imrs_protocol::{Class, PortView, TaskId};

/// The rows above the table.
const ABOVE: u16 = 3;

pub(super) fn draw(app: &App, now: Moment, pen: &mut Pen<'_>) {
    let queues = app.queues(now);
    let Some(end) = app.port(&queues) else {
        pen.line(1, &[(" No port of this cell receives messages.", Ink::Plain)]);
        return;
    };
    let Some(life) = app.store().life(end.life) else { return };
    let Some((task, view)) = life.task(end.task).zip(life.port(end.task, end.port)) else { return };
    let info = life.names.port(end.port);
    let at = queues
        .iter()
        .position(|q| *q == end)
        .map_or_else(String::new, |i| format!("{}/{}", i + 1, queues.len()));
    about(life, end.task, view, info, &at, now, pen);
    counters(view, pen);
    let whole = info.and_then(|i| i.time_out(end.task)).map_or(0, |t| t.0.saturating_mul(life.tick_us));
    let age_us = task.age_us;
    let mut table = pen.below(ABOVE);
    queue(app, life, view, (whole, age_us), now, &mut table);
}

/// The message at a row below the head.
pub(super) fn hit(app: &App, now: Moment, size: (u16, u16), y: u16) -> Option<Hit> {
    let end = app.port(&app.queues(now))?;
    let view = app.store().life(end.life)?.port(end.task, end.port)?;
    let row = usize::from(y.checked_sub(ABOVE + 1)?);
    let room = usize::from(size.1.saturating_sub(2 + ABOVE + 1));
    let at = first_row(app.entry(view), view.queue.len(), room) + row;
    (at < view.queue.len()).then_some(Hit::Entry(at))
}

fn about(
    life: &Life,
    task: TaskId,
    view: &PortView,
    info: Option<&PortInfo>,
    at: &str,
    now: Moment,
    pen: &mut Pen<'_>,
) {
    let presence = life.presence(now);
    let place = format!(" at {}@{}", life.names.task(task), life.node);
    let class = if view.class == Class::Command { "2" } else { "1" };
    let time_out =
        info.and_then(|i| i.time_out(task)).map(|t| Span::micros(t.0.saturating_mul(life.tick_us)));
    let time_out = time_out.map_or_else(String::new, |t| format!("  time_out {t}"));
    let users: Vec<_> = info.map_or(&[][..], |i| &i.parties).iter().filter(|p| p.task != task).collect();
    let users: Vec<_> = users.iter().map(|p| life.names.task(p.task).to_string()).collect();
    let with = format!("  usage {}  class {class}  with {}{time_out}", view.usage, users.join(","));
    let name = format!(" {}", life.names.port_name(view.port));
    let fill = format!("  buffer {}/{}", view.len, view.capacity);
    let gone = if presence.is_gone() { format!("  {presence}: last state") } else { String::new() };
    pen.line(
        0,
        &[
            (&name, Ink::Head),
            (&place, Ink::Plain),
            (&gone, Ink::Bad),
            (&fill, Ink::Plain),
            (&with, Ink::Dim),
            ("  port ", Ink::Dim),
            (at, Ink::Dim),
        ],
    );
}

fn counters(view: &PortView, pen: &mut Pen<'_>) {
    let c = &view.counters;
    let all = [
        ("in", c.enqueued),
        ("served", c.delivered),
        ("expired", c.expired),
        ("refused", c.refused),
        ("evicted", c.evicted),
        ("rejected", c.rejected),
        ("dup", c.duplicates),
        ("dropped", c.dropped),
        ("sent", c.sent),
        ("re-sent", c.resent),
        ("timed out", c.timed_out),
    ];
    let shown = all.iter().enumerate().filter(|(i, (_, n))| *i < 3 || *n > 0);
    let text: Vec<_> = shown.map(|(_, (name, n))| format!("{name} {n}")).collect();
    pen.line(1, &[(" since start: ", Ink::Dim), (&text.join("  "), Ink::Plain)]);
}

fn queue(app: &App, life: &Life, view: &PortView, whole_age: (u64, u64), now: Moment, pen: &mut Pen<'_>) {
    let (whole, age_us) = whole_age;
    let wide = pen.area.width >= 60;
    let mut columns = vec![Column::right("#", 4), Column::left("FROM", if wide { 16 } else { 8 })];
    if wide {
        columns.extend([Column::left("MSG", 12), Column::left("CLS", 3)]);
    }
    columns.extend([Column::right("REMAIN", 8), Column::left("LEFT OF LIFE", 0)]);
    let widths = pen.widths(&columns);
    pen.titles(0, &columns, &widths);
    if view.queue.is_empty() {
        pen.line(1, &[("    - no message waits -", Ink::Dim)]);
        return;
    }
    let room = usize::from(pen.height().saturating_sub(1));
    let last = widths.last().copied().unwrap_or(0);
    for (y, (i, entry)) in (1..).zip(view.queue.iter().enumerate().skip(app.scroll).take(room)) {
        let left = life.left(entry.remaining, age_us, now);
        let urgent = left.us < whole / 10;
        let ink = if left.us == 0 {
            Ink::Bad
        } else if urgent {
            Ink::Warn
        } else {
            Ink::Plain
        };
        let number = (i + 1).to_string();
        let from = life.names.task(entry.source);
        let id = format!("#{}", entry.id);
        let class = if entry.class == Class::Command { "2" } else { "1" };
        let remain = if left.us == 0 { "expired".to_owned() } else { left.to_string() };
        let bar = format!("[{}]", bar(&app.theme, last.saturating_sub(2).min(60), left.us, whole));
        let mut cells = vec![(number.as_str(), Ink::Dim), (from.shown(), Ink::Plain)];
        if wide {
            cells.extend([(id.as_str(), Ink::Dim), (class, Ink::Plain)]);
        }
        cells
            .extend([(remain.as_str(), ink), (bar.as_str(), if ink == Ink::Plain { Ink::Bar } else { ink })]);
        pen.row(y, &columns, &widths, &cells);
    }
    let listed = app.scroll + room;
    let hidden = usize::from(view.len).max(view.queue.len()).saturating_sub(listed);
    if hidden > 0 && pen.height() > 0 {
        let text = format!(" {hidden} more ");
        let x = pen.area.width.saturating_sub(u16::try_from(text.len()).unwrap_or(0));
        pen.at(x, 0, u16::MAX, &text, Ink::Head);
    }
}
