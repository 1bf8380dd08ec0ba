//! Screen 1: nodes, their tasks and their ports. Each row shows the most severe finding within it.

use super::canvas::{self, Canvas, bar, first_row};
use super::columns::{HEALTH_CELL, columns, sort_of};
use super::{Hit, below, mark};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::rows::{Row, Sort};
use crate::store::blocked::Blocker;
use crate::store::health::{Finding, Place, held_back_words};
use crate::store::journal::Severity;
use crate::store::meeting::state;
use crate::store::{IncarnationId, Left, NodeIncarnation, Presence, is_killed};
use crate::theme::Ink;
use imrs_protocol::{PortCounters, PortView, TaskId, Usage};
use imrs_wire::obs::{Liveness, RealTime, TaskSnapshot};
use std::time::Duration;

/// Name, state, queue, slack, rate, expired, overflow, rejected, re-sent, timed out, health.
type Cells = [(String, Ink); 11];

pub(super) fn draw(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let rows = app.rows(findings, now);
    let selected = app.selected(&rows);
    let (columns, shown) = columns(canvas.area.width);
    let mut titles = canvas.below(0);
    let indented = ratatui::layout::Rect {
        x: titles.area.x + 2.min(titles.area.width),
        width: titles.area.width.saturating_sub(2),
        ..titles.area
    };
    titles.area = indented;
    let widths = titles.widths(&columns);
    titles.titles(0, &columns, &widths);
    let mut start = 0;
    for (column, width) in columns.iter().zip(&widths) {
        if let Some(sort) = sort_of(column.title) {
            titles.target(start, 0, *width, Hit::Title(sort));
            if sort == app.shape.sort && sort != Sort::Name {
                let indent =
                    if column.right { width.saturating_sub(canvas::columns(column.title)) } else { 0 };
                titles.at(start + indent, 0, width - indent, column.title, Ink::Head);
            }
        }
        start += width + 1;
    }
    if app.shape.sort != Sort::Name || app.shape.inverted {
        let inverted = if app.shape.inverted { "inverted" } else { "" };
        let both = format!("by {} {inverted}", app.shape.sort.word()).trim_end().to_owned();
        titles.corner(0, &[both, inverted.to_owned()], Ink::Head);
    }
    let below = below::rows(canvas.height());
    let height = usize::from(canvas.height().saturating_sub(1 + below));
    let first = first_row(selected, rows.len(), height);
    let foot = canvas.height().saturating_sub(below);
    below::draw(app, now, &mut canvas.below(foot));
    canvas.list(height, rows.len());
    // Only visible rows are built, so that a cell of ten thousand ports costs no more.
    for (y, (i, row)) in (1..).zip(rows.iter().enumerate().skip(first).take(height)) {
        let mut cells = cells(app, row, findings, canvas.area.width, now);
        accuse(app, row, findings, blockers, canvas.area.width, &mut cells);
        let cells: Vec<_> = shown.iter().map(|&c| (cells[c].0.as_str(), cells[c].1)).collect();
        if i == selected {
            canvas.at(0, y, 1, app.theme.glyphs.selected, Ink::Head);
        }
        let mut inner = canvas.below(0);
        inner.area = indented;
        inner.row(y, &columns, &widths, &cells);
        if i == selected {
            canvas.select(y);
        }
        canvas.target(0, y, canvas.area.width, Hit::Row(row.place));
    }
}

/// The name of a place: `node.task.port`, as far as it goes.
pub(crate) fn label(app: &App, place: Place) -> String {
    let store = app.store();
    let Ok(incarnation) = place.node else {
        let cell = app.cell().and_then(|c| store.names(&c).cloned());
        return cell.zip(place.node.err()).map_or_else(String::new, |(names, id)| names.node(id).to_string());
    };
    let Some(incarnation) = store.incarnation(incarnation) else { return String::new() };
    let mut text = incarnation.node.to_string();
    if let Some(task) = place.task {
        text += &format!(".{}", incarnation.names.task(task));
    }
    if let Some(port) = place.port {
        text += &format!(".{}", incarnation.names.port_name(port));
    }
    text
}

fn cells(app: &App, row: &Row, findings: &[Finding], width: u16, now: Moment) -> Cells {
    let (health, ink) = health(row, findings, width);
    let mut cells: Cells = std::array::from_fn(|_| (String::new(), Ink::Plain));
    match row.place.node {
        Err(id) => {
            let cell = app.cell();
            let names = cell.as_ref().and_then(|cell| Some((cell, app.store().names(cell)?)));
            let name = names.map(|(cell, names)| (cell, names.node(id)));
            let killed = name.as_ref().is_some_and(|(cell, name)| is_killed(app.store(), cell, name));
            let name = name.map_or_else(String::new, |(_, name)| name.to_string());
            let sign = if killed { app.theme.glyphs.dead } else { "?" };
            cells[0] = (format!("{sign} {name}"), Ink::Dim);
            cells[1] = (if killed { "DEAD" } else { "not seen here" }.to_owned(), Ink::Dim);
        }
        Ok(id) => {
            let Some(incarnation) = app.store().incarnation(id) else { return cells };
            let gone = incarnation.presence(now).is_gone();
            match (row.place.task.and_then(|t| incarnation.task(t)), row.place.port) {
                (None, _) => node(app, incarnation, row, now, &mut cells),
                (Some(task), None) => self::task(app, incarnation, task, row, now, &mut cells),
                (Some(task), Some(port)) => {
                    if let Some(view) = task.view.ports.iter().find(|p| p.port == port) {
                        self::port(app, incarnation, task, view, width, now, &mut cells);
                    }
                }
            }
            if gone {
                for (_, ink) in &mut cells {
                    *ink = Ink::Dim;
                }
            }
        }
    }
    // The health of what has ended is not known to be good. An earlier incarnation has no findings at all.
    let ended = row.place.node.is_ok_and(|id| {
        let earlier =
            app.store().incarnation(id).is_some_and(|incarnation| !app.store().is_present(incarnation));
        earlier || row.depth > 0 && is_gone(app, id, now)
    });
    cells[HEALTH_CELL] = if ended && ink == Ink::Good { ("-".to_owned(), Ink::Dim) } else { (health, ink) };
    cells
}

fn is_gone(app: &App, id: IncarnationId, now: Moment) -> bool {
    app.store().incarnation(id).is_some_and(|incarnation| incarnation.presence(now).is_gone())
}

fn fold_sign(app: &App, row: &Row) -> &'static str {
    match (row.parent, row.open) {
        (true, true) => app.theme.glyphs.open,
        (true, false) => app.theme.glyphs.closed,
        (false, _) => " ",
    }
}

fn node(app: &App, incarnation: &NodeIncarnation, row: &Row, now: Moment, cells: &mut Cells) {
    let presence = incarnation.presence(now);
    let sign = if presence.is_gone() { app.theme.glyphs.dead } else { fold_sign(app, row) };
    // A node of the checker has no process.
    let pid = if incarnation.pid == 0 { String::new() } else { format!(" (pid {})", incarnation.pid) };
    cells[0] = (format!("{sign} {}{pid}", incarnation.node), Ink::Plain);
    let uptime = incarnation.last.as_ref().map(|s| Duration::from_micros(s.snapshot.uptime_us));
    cells[1] = match (presence, uptime) {
        (Presence::Up, Some(uptime)) => {
            let again = if is_restarted(app, incarnation) {
                format!(" (incarn. {})", incarnation.number)
            } else {
                String::new()
            };
            (format!("up {}{again}", Span(uptime)), Ink::Good)
        }
        (Presence::Up, None) => ("attached".to_owned(), Ink::Plain),
        (Presence::Silent(_), _) => (presence.to_string(), Ink::Warn),
        _ => (format!("{presence} (incarn. {})", incarnation.number), Ink::Dim),
    };
    let longest = incarnation.longest_held_back(now);
    if let Some(longest) = longest.filter(|_| matches!(presence, Presence::Up)) {
        cells[1] = (format!("up, held back {} s", longest.div_ceil(1_000_000)), Ink::Warn);
    }
    match incarnation.last.as_ref().map(|s| s.snapshot.real_time).filter(|_| !presence.is_gone()) {
        Some(RealTime::Had) => cells[1].0 += "  rt",
        Some(RealTime::Refused { .. }) => cells[1] = (format!("{}  NO RT", cells[1].0), Ink::Warn),
        Some(RealTime::NotAsked) | None => {}
    }
    sum(app, incarnation, incarnation.tasks(), now, cells);
    if let Some(transit) =
        incarnation.last.as_ref().map(|s| &s.snapshot.transit).filter(|t| t.len > 0 && !presence.is_gone())
    {
        cells[1].0 += &format!("  transit {}", transit.len);
    }
}

/// Whether the monitor has seen an earlier incarnation of the node.
fn is_restarted(app: &App, incarnation: &NodeIncarnation) -> bool {
    let all = app.store().incarnations_of(&incarnation.names.cell);
    all.filter(|other| other.node_id == incarnation.node_id).count() > 1
}

fn task(
    app: &App,
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    row: &Row,
    now: Moment,
    cells: &mut Cells,
) {
    cells[0] = (format!("  {} {}", fold_sign(app, row), incarnation.names.task(task.view.task)), Ink::Plain);
    cells[1] = match task.liveness {
        Liveness::Crashed => ("CRASHED".to_owned(), Ink::Bad),
        Liveness::Ended => ("ended".to_owned(), Ink::Dim),
        Liveness::Alive if let Some(us) = incarnation.task_held_back(task.view.task, now) => {
            (held_back_words(us), Ink::Warn)
        }
        Liveness::Alive => {
            let left = remaining(incarnation, task, now).map_or_else(String::new, |left| format!(" {left}"));
            (state(incarnation, &task.view.state) + &left, Ink::Plain)
        }
    };
    sum(app, incarnation, std::slice::from_ref(task), now, cells);
}

/// The remaining time of the task's present wait.
fn remaining(incarnation: &NodeIncarnation, task: &TaskSnapshot, now: Moment) -> Option<Left> {
    use imrs_protocol::TaskState::{AwaitingReply, Delaying, Receiving, Running, Waiting};
    let remaining = match task.view.state {
        Running | Delaying => None,
        Receiving { remaining, .. } => remaining,
        AwaitingReply { remaining, .. } | Waiting { remaining, .. } => Some(remaining),
    };
    remaining.map(|r| incarnation.left(r, task.age_us, now))
}

/// The sums over the ports of tasks: queue, least slack, rate, counters.
fn sum(app: &App, incarnation: &NodeIncarnation, tasks: &[TaskSnapshot], now: Moment, cells: &mut Cells) {
    let (mut len, mut capacity, mut rate) = (0_u64, 0_u64, None::<f64>);
    let mut least: Option<Left> = None;
    let mut total = PortCounters::default();
    for task in tasks {
        let earlier = incarnation.earlier(task);
        let slacks = task.view.ports.iter().filter_map(|port| port.min_slack);
        let left = slacks.min().map(|slack| incarnation.left(slack, task.age_us, now));
        least = [least, left].into_iter().flatten().min();
        for port in &task.view.ports {
            if port.usage != Usage::Waitfor {
                len += u64::from(port.len);
                capacity += u64::from(port.capacity);
            }
            rate = [rate, incarnation.rate_of(earlier, port)].into_iter().flatten().reduce(|a, b| a + b);
            let c = counted(app, incarnation, task.view.task, port);
            total.expired = total.expired.saturating_add(c.expired);
            total.refused = total.refused.saturating_add(c.refused).saturating_add(c.evicted);
            total.rejected = total.rejected.saturating_add(c.rejected);
            total.resent = total.resent.saturating_add(c.resent);
            total.timed_out = total.timed_out.saturating_add(c.timed_out);
        }
    }
    if capacity > 0 {
        cells[2] = (format!("{len}/{capacity}"), Ink::Plain);
    }
    cells[3] = (least.map_or_else(|| "-".to_owned(), |l| l.to_string()), Ink::Plain);
    cells[4] = (per_second(rate), Ink::Plain);
    counts(cells, &total);
}

/// A port's counters since the start, or since the mark if the user chose that.
fn counted(app: &App, incarnation: &NodeIncarnation, task: TaskId, view: &PortView) -> PortCounters {
    let marked = app.mark().filter(|_| app.since_mark);
    let before = marked
        .and_then(|(_, store)| store.incarnation(incarnation.id)?.port(task, view.port))
        .map(|p| p.counters);
    let (now, before) = (view.counters, before.unwrap_or_default());
    PortCounters {
        expired: now.expired.saturating_sub(before.expired),
        refused: now.refused.saturating_sub(before.refused),
        evicted: now.evicted.saturating_sub(before.evicted),
        rejected: now.rejected.saturating_sub(before.rejected),
        resent: now.resent.saturating_sub(before.resent),
        timed_out: now.timed_out.saturating_sub(before.timed_out),
        ..now
    }
}

fn per_second(rate: Option<f64>) -> String {
    rate.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.0}"))
}

fn counts(cells: &mut Cells, c: &PortCounters) {
    let overflow = c.refused.saturating_add(c.evicted);
    for (cell, count) in [(5, c.expired), (6, overflow), (7, c.rejected), (8, c.resent), (9, c.timed_out)] {
        cells[cell] = (short(count), if count > 0 { Ink::Warn } else { Ink::Dim });
    }
}

fn short(count: u64) -> String {
    match count {
        0..10_000 => count.to_string(),
        10_000..10_000_000 => format!("{}k", count / 1000),
        _ => format!("{}M", count / 1_000_000),
    }
}

fn port(
    app: &App,
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    view: &PortView,
    width: u16,
    now: Moment,
    cells: &mut Cells,
) {
    cells[0] = (format!("      {}", incarnation.names.port_name(view.port)), Ink::Plain);
    let info = incarnation.names.port(view.port);
    let parties = info.map_or(0, |i| i.parties.len());
    let class = if view.class == imrs_protocol::Class::Command { "c2" } else { "c1" };
    cells[1] = (format!("{class} {} {parties} parties", view.usage), Ink::Dim);
    if view.usage == Usage::Waitfor {
        let meeting = task.view.meetings.iter().find(|m| m.port == view.port);
        let arrived = meeting.map_or(0, |m| m.members.iter().filter(|m| m.arrived).count());
        cells[2] = (format!("{arrived}/{parties}"), Ink::Plain);
        let left = meeting.and_then(|m| m.remaining).map(|r| incarnation.left(r, task.age_us, now));
        cells[3] = (left.map_or_else(|| "-".to_owned(), |l| l.to_string()), Ink::Plain);
    } else if view.capacity > 0 {
        let fill = bar(&app.theme, 5, view.len.into(), view.capacity.into());
        let fill = if width < 116 { String::new() } else { format!(" {fill}") };
        cells[2] = (format!("{}/{}{fill}", view.len, view.capacity), Ink::Plain);
        let left = view.min_slack.map(|s| incarnation.left(s, task.age_us, now));
        cells[3] = (left.map_or_else(|| "-".to_owned(), |l| l.to_string()), Ink::Plain);
    }
    cells[4] = (per_second(incarnation.rate(task.view.task, view.port)), Ink::Plain);
    counts(cells, &counted(app, incarnation, task.view.task, view));
}

/// Marks the row of what blocks the cell, and those of the tasks that it holds.
fn accuse(app: &App, row: &Row, findings: &[Finding], blockers: &[Blocker], width: u16, cells: &mut Cells) {
    let mut alarming = blockers.iter().filter(|blocker| blocker.is_alarming());
    // What only follows from a block is not as loud as its cause.
    let worst = findings.iter().find(|finding| row.place.holds(&finding.place));
    if worst.is_some_and(|worst| blockers.iter().any(|blocker| blocker.explains(worst))) {
        cells[HEALTH_CELL].1 = Ink::Warn;
    }
    let is_shown_within = |blocker: &Blocker| row.open && row.place != blocker.place;
    if let Some(blocker) =
        alarming.clone().find(|blocker| blocker.is_within(&row.place) && !is_shown_within(blocker))
    {
        cells[0].1 = Ink::Alarm;
        let names = app.cell().and_then(|cell| app.store().names(&cell));
        let all = names.map_or(0, |names| names.tasks.len());
        // A finding of its own says more than the number of tasks that wait.
        if width >= 60 && !blocker.by.is_empty() && row.depth == 1 {
            let own = findings.iter().find(|f| row.place.holds(&f.place) && !blocker.explains(f));
            let own = own.map_or_else(String::new, |f| format!("; {}", f.text));
            let text = format!("{} holds {} of {all}{own}", mark(blocker.level), blocker.by.len());
            cells[HEALTH_CELL] = (text, Ink::Bad);
        }
        return;
    }
    // A row of a port has its own findings.
    let Some(blocker) = alarming.find(|blocker| row.depth == 1 && blocker.holds(&row.place)) else { return };
    let worst = findings.iter().find(|f| row.place.holds(&f.place) && !blocker.explains(f));
    if worst.is_none() {
        let text = if width < 60 { String::new() } else { format!(" held by {}", blocker.name) };
        cells[HEALTH_CELL] = (format!("!{text}"), Ink::Warn);
    }
    cells[0].1 = Ink::Warn;
}

/// The most severe finding within a row; on a narrow screen only its sign.
fn health(row: &Row, findings: &[Finding], width: u16) -> (String, Ink) {
    let Some(worst) = findings.iter().find(|f| row.place.holds(&f.place)) else {
        let never_seen = row.place.node.is_err();
        let text = if never_seen { "?" } else { "ok" };
        return (text.to_owned(), if never_seen { Ink::Dim } else { Ink::Good });
    };
    let ink = if worst.level == Severity::Bad { Ink::Bad } else { Ink::Warn };
    let text = if width < 60 { String::new() } else { format!(" {}", worst.text) };
    (format!("{}{text}", mark(worst.level)), ink)
}
