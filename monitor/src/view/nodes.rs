//! The cells of a node's row, and of the row that stands for the healthy nodes.

use super::canvas::Canvas;
use super::columns::Cells;
use super::sums::Sum;
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::rows::Row;
use crate::store::{Condition, IncarnationId, NodeIncarnation, Presence};
use crate::theme::Ink;
use imrs_wire::obs::RealTime;
use std::time::Duration;

/// The sign of a row with rows within it.
pub(super) fn fold_sign(app: &App, row: &Row) -> &'static str {
    match (row.parent, row.open) {
        (true, true) => app.theme.glyphs.open,
        (true, false) => app.theme.glyphs.closed,
        (false, _) => " ",
    }
}

/// Fills the table cells of a node's row.
pub(super) fn node(app: &App, incarnation: &NodeIncarnation, row: &Row, now: Moment, cells: &mut Cells) {
    let presence = incarnation.presence(now);
    let sign = if presence.is_gone() { app.theme.glyphs.dead } else { fold_sign(app, row) };
    // A node of the checker's counterexample has no process.
    let pid = if incarnation.pid == 0 { String::new() } else { format!(" (pid {})", incarnation.pid) };
    cells[0] = (format!("{sign} {}{pid}", incarnation.node), Ink::Plain);
    let uptime = incarnation.last.as_ref().map(|s| Duration::from_micros(s.snapshot.uptime_us));
    cells[1] = match (presence, uptime) {
        (Presence::Up, Some(uptime)) => {
            (format!("up {}{}", Span(uptime).in_seconds(), restarts(app, incarnation)), Ink::Good)
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
    Sum::of(app, incarnation, incarnation.tasks(), now).show(cells);
    if let Some(transit) =
        incarnation.last.as_ref().map(|s| &s.snapshot.transit).filter(|t| t.len > 0 && !presence.is_gone())
    {
        cells[1].0 += &format!("  transit {}", transit.len);
    }
}

/// What the row of a restarted node says about the node's incarnations.
fn restarts(app: &App, incarnation: &NodeIncarnation) -> String {
    let all = app.store().incarnations_of(&incarnation.names.cell);
    let is_restarted = all.filter(|other| other.node_id == incarnation.node_id).count() > 1;
    match (is_restarted, app.store().deaths_before(incarnation)) {
        (false, _) => String::new(),
        (true, 0) => format!(" incarnation {}", incarnation.number),
        (true, 1) => format!(" incarnation {}, 1 death", incarnation.number),
        (true, deaths) => format!(" incarnation {}, {deaths} deaths", incarnation.number),
    }
}

/// The cells of the row that stands for the healthy nodes.
pub(super) fn healthy(app: &App, nodes: &[IncarnationId], row: &Row, now: Moment, cells: &mut Cells) {
    let nodes: Vec<_> = nodes.iter().filter_map(|id| app.store().incarnation(*id)).collect();
    cells[0] = (format!("{} {} nodes", fold_sign(app, row), nodes.len()), Ink::Plain);
    let names: Vec<_> = nodes.iter().map(|incarnation| incarnation.node.shown()).collect();
    cells[1] = (format!("up: {}", names.join(", ")), Ink::Good);
    let mut sum = Sum::default();
    for incarnation in nodes {
        sum.add(app, incarnation, incarnation.tasks(), now);
    }
    sum.show(cells);
}

/// The least width of a sparkline, in columns.
const LEAST: u16 = 5;
/// The greatest width of a sparkline, in columns.
const MOST: u16 = 20;

/// Draws sparklines of a node into the free columns from `free.0` to before `free.1`: its messages per second, and its
/// least slack.
pub(super) fn sparklines(app: &App, row: &Row, free: (u16, u16), y: u16, canvas: &mut Canvas<'_>) {
    let incarnation = row.place.node.ok().and_then(|id| app.store().incarnation(id));
    let Some(incarnation) = incarnation else { return };
    let room = free.1.saturating_sub(free.0);
    let width = (room.saturating_sub(2) / 2).min(MOST);
    if width < LEAST || incarnation.recent.seconds().len() == 0 {
        return;
    }
    let is_latest = app.store().is_present(incarnation);
    let ink = if is_latest && incarnation.condition == Condition::Attached { Ink::Bar } else { Ink::Dim };
    let messages: Vec<_> = incarnation.recent.seconds().map(|second| Some(second.messages)).collect();
    let slack: Vec<_> = incarnation.recent.seconds().map(|second| second.slack_us).collect();
    canvas.sparkline((free.1 - 2 * width - 1, y), width, &messages, None, ink);
    canvas.sparkline((free.1 - width, y), width, &slack, None, Ink::Dim);
}
