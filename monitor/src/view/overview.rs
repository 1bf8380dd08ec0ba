//! Screen 1: nodes, their tasks and their ports. Each row shows the most severe finding within it.

use super::accused::{accuse, health};
use super::canvas::{self, Canvas, Column, bar, first_row};
use super::columns::{Cells, HEALTH_CELL, Needs, columns, sort_of};
use super::lists::Window;
use super::sums::{Counts, Sum, per_second};
use super::{Hit, below, nodes};
use crate::app::App;
use crate::clock::Moment;
use crate::keys::Action;
use crate::rows::{Row, Sort};
use crate::store::blocked::Blocker;
use crate::store::health::{Finding, Place, held_back_words};
use crate::store::meeting::state;
use crate::store::{IncarnationId, Left, NodeIncarnation, is_killed};
use crate::theme::Ink;
use imrs_protocol::{PortView, Usage};
use imrs_wire::obs::{Liveness, TaskSnapshot};
use ratatui::layout::Rect;

pub(super) fn draw(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let healthy = app.healthy(findings, now);
    let rows = app.rows(findings, now);
    let selected = app.selected(&rows);
    let below = below::rows(canvas.height());
    let height = usize::from(canvas.height().saturating_sub(1 + below));
    let window = Window { first: first_row(selected, rows.len(), height), page: height, lines: rows.len() };
    let foot = canvas.height().saturating_sub(below);
    below::draw(app, now, &mut canvas.below(foot));
    canvas.list(height, rows.len());
    let whole = canvas.area;
    let list = Rect { height: foot.min(whole.height), ..whole };
    let width = canvas.part(list).beside_scrollbar(1, window).area.width;
    let indent = 2.min(width);
    let inner = Rect { x: whole.x + indent, width: width - indent, ..list };
    // Only the cells of visible rows are computed, so that the time for a frame does not grow with the number of
    // ports.
    let shown: Vec<_> = (rows.iter().enumerate().skip(window.first).take(height))
        .map(|(i, row)| (i, row, row_cells(app, row, (findings, blockers, &healthy), (whole.width, now))))
        .collect();
    let needs = needs(app, &shown);
    let (columns, of) = columns((whole.width, inner.width), needs, &app.columns);
    let widths = canvas.part(inner).widths(&columns);
    titles(app, (&columns, &widths), &window.position(selected), &mut canvas.part(inner));
    if rows.is_empty() && !app.filter().is_empty() {
        let change = Some(Hit::Key(Action::Filter));
        canvas.part(inner).facts(1, &[("No row fulfils this filter.", Ink::Dim, change)]);
    }
    for (y, shown) in (1..).zip(&shown) {
        let (i, row, (cells, _)) = shown;
        let state = of.iter().position(|cell| *cell == 1).map(|at| (at, widths[at]));
        let state_text = state.map_or("", |(_, width)| that_fits(app, shown, width));
        let text = |cell: usize| if cell == 1 { state_text } else { &cells[cell].0 };
        let texts: Vec<_> = of.iter().map(|&c| (text(c), cells[c].1)).collect();
        let mut inner = canvas.part(inner);
        inner.row(y, &columns, &widths, &texts);
        if row.depth == 0
            && let Some((at, width)) = state
        {
            let x = widths[..at].iter().map(|width| width + 1).sum::<u16>();
            let taken = canvas::columns(state_text).min(width);
            nodes::sparklines(app, row, (x + taken, x + width), y, &mut inner);
        }
        let mut line = canvas.part(Rect { width, ..whole });
        let is_selected = *i == selected;
        if is_selected {
            line.cursor(y);
        }
        if cells[0].1 == Ink::Alarm {
            line.alarm(y, is_selected);
        }
        line.target(0, y, width, Hit::Row(row.place));
    }
}

/// A row that is shown: its index, the row, its cells, and shorter texts of its state.
type Shown<'a> = (usize, &'a Row, (Cells, Vec<String>));

/// How many columns the state of the healthy nodes has at least beside other rows: enough for a name.
const HEALTHY: u16 = 16;

/// How many columns the cells on the screen need.
fn needs(app: &App, shown: &[Shown<'_>]) -> Needs {
    let mut needs = Needs { state: canvas::columns("STATE"), ..Needs::default() };
    for (_, row, (cells, shorter)) in shown {
        let [name, state, queue] = [0, 1, 2].map(|cell: usize| canvas::columns(&cells[cell].0));
        needs.name = needs.name.max(name);
        needs.queue = needs.queue.max(queue);
        needs.health = needs.health.max(canvas::columns(&cells[HEALTH_CELL].0));
        // The row of the healthy nodes can name fewer of them. It takes more width only if it is alone.
        if row.place == Place::HEALTHY {
            needs.state = needs.state.max(if shown.len() == 1 { state } else { state.min(HEALTHY) });
            continue;
        }
        needs.state = needs.state.max(state);
        if row.depth == 0 {
            let shortest = shorter.last().map_or(state, |text| canvas::columns(text));
            needs.shortest_state = needs.shortest_state.max(shortest);
            if nodes::has_sparklines(app, row) {
                let (whole, least) = needs.sparks;
                needs.sparks = (whole.max(nodes::beside(state)), least.max(nodes::beside(shortest)));
            }
        }
    }
    needs
}

/// The longest text of a row's state that fits into `width` columns, if possible with sparklines beside it; the shortest
/// one if none fits.
fn that_fits<'a>(app: &App, (_, row, (cells, shorter)): &'a Shown<'_>, width: u16) -> &'a str {
    let mut texts = std::iter::once(&cells[1].0).chain(shorter);
    let has_sparklines = row.depth == 0 && nodes::has_sparklines(app, row);
    let beside = texts.clone().find(|text| has_sparklines && nodes::beside(canvas::columns(text)) <= width);
    let fits = beside.or_else(|| texts.clone().find(|text| canvas::columns(text) <= width));
    fits.or_else(|| texts.next_back()).map_or("", String::as_str)
}

/// Draws the titles of the columns, each a target of clicks, and behind them the sort order and the position.
fn titles(
    app: &App,
    (columns, widths): (&[Column], &[u16]),
    position: &(String, Option<Hit>),
    canvas: &mut Canvas<'_>,
) {
    let mut start = 0;
    for (column, width) in columns.iter().zip(widths) {
        if let Some(sort) = sort_of(column.title) {
            canvas.target(start, 0, *width, Hit::Title(sort, column.title));
        }
        start += width + 1;
    }
    canvas.titles(0, columns, widths);
    let mut start = 0;
    for (column, width) in columns.iter().zip(widths) {
        if sort_of(column.title).is_some_and(|sort| sort == app.shape.sort && sort != Sort::Name) {
            let indent = if column.right { width.saturating_sub(canvas::columns(column.title)) } else { 0 };
            canvas.at(start + indent, 0, width - indent, column.title, Ink::Head);
        }
        start += width + 1;
    }
    let is_sorted = app.shape.sort != Sort::Name || app.shape.inverted;
    let order = if is_sorted { format!("by {}", app.shape.sort.word()) } else { String::new() };
    let order = (order, Some(Hit::Key(Action::Sort)));
    let inverted = |text: &str| {
        let text = if app.shape.inverted { text } else { "" };
        (text.to_owned(), Some(Hit::Key(Action::Invert)))
    };
    let gap = (if is_sorted && !position.0.is_empty() { "  " } else { "" }.to_owned(), None);
    let position = (position.0.trim_end().to_owned(), position.1);
    let texts = [
        vec![order.clone(), inverted(" inverted"), gap, position.clone()],
        vec![order, inverted(" inverted")],
        vec![position],
        vec![inverted("inverted")],
    ];
    canvas.corner(0, &texts, Ink::Head);
}

/// The findings, the blocks of the cell, and the healthy nodes that have no rows of their own.
type Known<'a> = (&'a [Finding], &'a [Blocker], &'a [IncarnationId]);

/// The cells of a row, and the shorter texts of its state.
fn row_cells(
    app: &App,
    row: &Row,
    (findings, blockers, healthy): Known<'_>,
    (screen, now): (u16, Moment),
) -> (Cells, Vec<String>) {
    let (mut cells, mut shorter) = cells(app, row, findings, (screen, now));
    if row.place == Place::HEALTHY {
        shorter = nodes::healthy(app, healthy, row, now, &mut cells);
    } else {
        accuse(app, row, findings, blockers, (screen, now), &mut cells);
    }
    (cells, shorter)
}

/// The name of a place: `node.task.port`, or a beginning of this.
pub(crate) fn label(app: &App, place: Place) -> String {
    let store = app.store();
    if place == Place::HEALTHY {
        return "healthy nodes".to_owned();
    }
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

fn cells(app: &App, row: &Row, findings: &[Finding], (screen, now): (u16, Moment)) -> (Cells, Vec<String>) {
    let (health, ink) = health(row, findings, screen);
    let mut cells: Cells = std::array::from_fn(|_| (String::new(), Ink::Plain));
    let mut shorter = Vec::new();
    match row.place.node {
        Err(_) if row.place == Place::HEALTHY => {}
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
            let Some(incarnation) = app.store().incarnation(id) else { return (cells, shorter) };
            let gone = incarnation.presence(now).is_gone();
            match (row.place.task.and_then(|t| incarnation.task(t)), row.place.port) {
                (None, _) => shorter = nodes::node(app, incarnation, row, (screen, now), &mut cells),
                (Some(task), None) => self::task(app, incarnation, task, row, now, &mut cells),
                (Some(task), Some(port)) => {
                    if let Some(view) = task.view.ports.iter().find(|p| p.port == port) {
                        self::port(app, incarnation, task, view, screen, now, &mut cells);
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
    // The health of an ended node or task is not known to be good. An earlier incarnation has no findings at all.
    let ended = row.place.node.is_ok_and(|id| {
        let earlier =
            app.store().incarnation(id).is_some_and(|incarnation| !app.store().is_present(incarnation));
        earlier || row.depth > 0 && nodes::is_gone(app, id, now)
    });
    cells[HEALTH_CELL] = if ended && ink == Ink::Good { ("-".to_owned(), Ink::Dim) } else { (health, ink) };
    (cells, shorter)
}

fn task(
    app: &App,
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    row: &Row,
    now: Moment,
    cells: &mut Cells,
) {
    cells[0] =
        (format!("  {} {}", nodes::fold_sign(app, row), incarnation.names.task(task.view.task)), Ink::Plain);
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
    Sum::of(app, incarnation, std::slice::from_ref(task), now).show(cells);
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

fn port(
    app: &App,
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    view: &PortView,
    screen: u16,
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
        let fill = if screen < 116 { String::new() } else { format!(" {fill}") };
        cells[2] = (format!("{}/{}{fill}", view.len, view.capacity), Ink::Plain);
        let left = view.min_slack.map(|s| incarnation.left(s, task.age_us, now));
        cells[3] = (left.map_or_else(|| "-".to_owned(), |l| l.to_string()), Ink::Plain);
    }
    cells[4] = (per_second(incarnation.rate(task.view.task, view.port)), Ink::Plain);
    Counts::of(app, incarnation, task.view.task, view, now).show(cells);
}
