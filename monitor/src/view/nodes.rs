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

/// Fills the table cells of a node's row. Returns what the state may say instead, each text shorter than the one before.
pub(super) fn node(
    app: &App,
    incarnation: &NodeIncarnation,
    row: &Row,
    (screen, now): (u16, Moment),
    cells: &mut Cells,
) -> Vec<String> {
    let presence = incarnation.presence(now);
    let sign = if presence.is_gone() { app.theme.glyphs.dead } else { fold_sign(app, row) };
    let restarts = restarts(app, incarnation);
    // A node of the checker's counterexample has no process. A screen without the state column shows the restarts
    // here; a somewhat wider one has no room for the process id, which few people need.
    let pid = match &restarts {
        Some((_, whole)) if screen < 60 => format!(" {whole}"),
        _ if incarnation.pid == 0 || (60..90).contains(&screen) => String::new(),
        _ => format!(" (pid {})", incarnation.pid),
    };
    cells[0] = (format!("{sign} {}{pid}", incarnation.node), Ink::Plain);
    let held_back = incarnation.longest_held_back(now).filter(|_| presence == Presence::Up);
    let (mut texts, ink) = match held_back {
        Some(us) => (held_back_texts(us.div_ceil(1_000_000), restarts), Ink::Warn),
        None => state_texts(incarnation, presence, restarts),
    };
    cells[1].1 = ink;
    let mut more = String::new();
    match incarnation.last.as_ref().map(|s| s.snapshot.real_time).filter(|_| !presence.is_gone()) {
        Some(RealTime::Had) => more += " rt",
        Some(RealTime::Refused { .. }) => {
            more += " NO RT";
            cells[1].1 = Ink::Warn;
        }
        Some(RealTime::NotAsked) | None => {}
    }
    let transit = incarnation.last.as_ref().map(|s| &s.snapshot.transit);
    if let Some(transit) = transit.filter(|t| t.len > 0 && !presence.is_gone()) {
        more += &format!(" transit {}", transit.len);
    }
    if !more.is_empty() {
        texts.insert(0, format!("{}{more}", texts[0]));
    }
    Sum::of(app, incarnation, incarnation.tasks(), now).show(cells);
    cells[1].0 = texts.remove(0);
    texts
}

/// What the state of a node that is not held back says, the longest text first.
fn state_texts(
    incarnation: &NodeIncarnation,
    presence: Presence,
    restarts: Option<(Option<String>, String)>,
) -> (Vec<String>, Ink) {
    let uptime = incarnation.last.as_ref().map(|s| Duration::from_micros(s.snapshot.uptime_us));
    match (presence, uptime, restarts) {
        (Presence::Up, Some(uptime), restarts) => {
            let up = format!("up {}", Span(uptime).in_seconds());
            // The incarnation comes first, because a narrow screen shows only the first words.
            let texts =
                restarts.map_or_else(|| vec![up.clone()], |(_, all)| vec![format!("{all} {up}"), all]);
            (texts, Ink::Good)
        }
        (Presence::Up, None, _) => (vec!["attached".to_owned()], Ink::Plain),
        (Presence::Silent(_), ..) => (vec![presence.to_string()], Ink::Warn),
        (_, _, Some((Some(deaths), all))) => (
            vec![format!("{presence}, {all}"), format!("{presence}, {deaths}"), presence.to_string()],
            Ink::Dim,
        ),
        _ => (vec![format!("{presence}, inc {}", incarnation.number), presence.to_string()], Ink::Dim),
    }
}

/// What the state of a held back node says, the longest text first.
fn held_back_texts(seconds: u64, restarts: Option<(Option<String>, String)>) -> Vec<String> {
    let short = format!("held back {seconds} s");
    match restarts {
        Some((Some(deaths), all)) => {
            vec![format!("up, {short}, {all}"), format!("{short}, {deaths}"), format!("held back, {deaths}")]
        }
        Some((None, all)) => vec![format!("up, {short}, {all}"), format!("up, {short}"), short],
        None => vec![format!("up, {short}"), short],
    }
}

/// What the row of a restarted node says about the node's incarnations: `8 deaths`, and `inc 9, 8 deaths`.
fn restarts(app: &App, incarnation: &NodeIncarnation) -> Option<(Option<String>, String)> {
    let all = app.store().incarnations_of(&incarnation.names.cell);
    let is_restarted = all.filter(|other| other.node_id == incarnation.node_id).count() > 1;
    let deaths = match (is_restarted, app.store().deaths_before(incarnation)) {
        (false, _) => return None,
        (true, 0) => None,
        (true, 1) => Some("1 death".to_owned()),
        (true, deaths) => Some(format!("{deaths} deaths")),
    };
    let number = format!("inc {}", incarnation.number);
    let whole = deaths.as_ref().map_or_else(|| number.clone(), |deaths| format!("{number}, {deaths}"));
    Some((deaths, whole))
}

/// The cells of the row that stands for the healthy nodes. Returns shorter texts of its state, with fewer names.
pub(super) fn healthy(
    app: &App,
    nodes: &[IncarnationId],
    row: &Row,
    now: Moment,
    cells: &mut Cells,
) -> Vec<String> {
    let nodes: Vec<_> = nodes.iter().filter_map(|id| app.store().incarnation(*id)).collect();
    cells[0] = (format!("{} {} nodes", fold_sign(app, row), nodes.len()), Ink::Plain);
    let names: Vec<_> = nodes.iter().map(|incarnation| incarnation.node.shown()).collect();
    cells[1] = (format!("up: {}", names.join(", ")), Ink::Good);
    let mut sum = Sum::default();
    for incarnation in nodes {
        sum.add(app, incarnation, incarnation.tasks(), now);
    }
    sum.show(cells);
    let fewer = (1..names.len()).rev().map(|few| {
        let (named, others) = names.split_at(few);
        format!("up: {} +{}", named.join(", "), others.len())
    });
    fewer.chain(["up".to_owned()]).collect()
}

/// The least width of a sparkline, in columns.
const LEAST: u16 = 5;
/// The greatest width of a sparkline, in columns.
const MOST: u16 = 20;

/// How many columns sparklines need beside a text that is `text` columns wide.
pub(super) const fn beside(text: u16) -> u16 {
    text.saturating_add(2 + 2 * LEAST)
}

/// Whether the row is of a node that has something to draw as sparklines.
pub(super) fn has_sparklines(app: &App, row: &Row) -> bool {
    with_sparklines(app, row).is_some()
}

fn with_sparklines<'a>(app: &'a App, row: &Row) -> Option<&'a NodeIncarnation> {
    let incarnation = row.place.node.ok().and_then(|id| app.store().incarnation(id));
    incarnation.filter(|incarnation| incarnation.recent.seconds().len() > 0)
}

/// Draws sparklines of a node into the free columns from `free.0` to before `free.1`: its messages per second, and its
/// least slack.
pub(super) fn sparklines(app: &App, row: &Row, free: (u16, u16), y: u16, canvas: &mut Canvas<'_>) {
    let Some(incarnation) = with_sparklines(app, row) else { return };
    let room = free.1.saturating_sub(free.0);
    let width = (room.saturating_sub(2) / 2).min(MOST);
    if width < LEAST {
        return;
    }
    let is_latest = app.store().is_present(incarnation);
    let ink = if is_latest && incarnation.condition == Condition::Attached { Ink::Bar } else { Ink::Dim };
    let messages: Vec<_> = incarnation.recent.seconds().map(|second| Some(second.messages)).collect();
    let slack: Vec<_> = incarnation.recent.seconds().map(|second| second.slack_us).collect();
    canvas.sparkline((free.1 - 2 * width - 1, y), width, &messages, None, ink);
    canvas.sparkline((free.1 - width, y), width, &slack, None, Ink::Dim);
}

/// Whether the node of an incarnation has died or stopped.
pub(super) fn is_gone(app: &App, id: IncarnationId, now: Moment) -> bool {
    app.store().incarnation(id).is_some_and(|incarnation| incarnation.presence(now).is_gone())
}
