//! Screen 6: the event log, newest entry at the bottom. It follows new entries until the user scrolls up; `G` resumes.

use super::mark;
use super::pen::{Column, Pen};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::store::journal::Level;
use crate::theme::Ink;

fn columns(width: u16) -> Vec<Column> {
    let mut columns = vec![Column::right("AGO", 6), Column::left("", 2)];
    if width >= 60 {
        columns.push(Column::left("NODE", 10));
    }
    columns.extend([Column::left("KIND", 10), Column::left("OBJECT", if width < 100 { 18 } else { 28 })]);
    if width >= 60 {
        columns.push(Column::left("DETAIL", 0));
    }
    columns
}

pub(super) fn draw(app: &App, now: Moment, pen: &mut Pen<'_>) {
    let lines = app.events();
    let columns = columns(pen.area.width);
    let widths = pen.widths(&columns);
    pen.titles(0, &columns, &widths);
    let room = usize::from(pen.height().saturating_sub(1));
    let last = lines.len().checked_sub(1);
    let Some(last) = last else {
        let text = if app.shape.filter.is_empty() {
            " Nothing to report so far."
        } else {
            " No event has this text."
        };
        pen.line(1, &[(text, Ink::Dim)]);
        return;
    };
    let bottom = app.held.map_or(last, |held| lines.iter().rposition(|e| e.number <= held).unwrap_or(0));
    let first = (bottom + 1).saturating_sub(room);
    for (y, (i, entry)) in (1..).zip(lines.iter().enumerate().skip(first).take(room)) {
        let level = entry.level();
        let ink = match level {
            Level::Trace => Ink::Dim,
            Level::Note => Ink::Plain,
            Level::Warn => Ink::Warn,
            Level::Bad => Ink::Bad,
        };
        let ago = Span(now.saturating_sub(entry.at)).to_string();
        let times = if entry.times > 1 { format!(" x{}", entry.times) } else { String::new() };
        let (object, detail) = (entry.object(), entry.detail() + &times);
        let narrow = format!("{object}{times} {detail}");
        let mut cells = vec![(ago.as_str(), Ink::Dim), (mark(level), ink)];
        if widths.len() > 4 {
            cells.extend([(entry.node.shown(), Ink::Plain), (entry.kind(), ink)]);
            cells.extend([(object.as_str(), Ink::Plain), (detail.as_str(), ink)]);
        } else {
            cells.extend([(entry.kind(), ink), (narrow.as_str(), Ink::Plain)]);
        }
        pen.row(y, &columns, &widths, &cells);
        if app.held.is_some() && i == bottom {
            pen.select(y);
        }
    }
    let newer = last - bottom;
    let text = match (app.held, app.everything) {
        (Some(_), _) => format!(" +{newer} new, G follows "),
        (None, true) => " every event, following ".to_owned(),
        (None, false) => " following ".to_owned(),
    };
    let x = pen.area.width.saturating_sub(u16::try_from(text.len()).unwrap_or(0));
    pen.at(x, 0, u16::MAX, &text, if app.held.is_some() { Ink::Warn } else { Ink::Dim });
}
