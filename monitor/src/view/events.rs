//! Screen 6: the event log, newest entry at the bottom. It follows new entries until the user scrolls up; `G` resumes.

use super::canvas::{Canvas, Column};
use super::lists::Window;
use super::{Hit, mark};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::keys::Action;
use crate::store::journal::{Entry, Severity};
use crate::theme::Ink;
use std::time::Duration;

fn columns(width: u16) -> Vec<Column> {
    let mut columns = vec![Column::right("AGO", 6), Column::left("!", 2)];
    if width >= 60 {
        columns.push(Column::left("NODE", 10));
    }
    let object = match width {
        0..100 => 18,
        100..160 => 22,
        _ => 28,
    };
    columns.extend([Column::left("KIND", 11), Column::left("OBJECT", object)]);
    if width >= 60 {
        columns.push(Column::left("DETAIL", 0));
    }
    columns
}

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let lines = app.events();
    let room = usize::from(canvas.height().saturating_sub(1));
    canvas.list(room, lines.len());
    let last = lines.len().checked_sub(1);
    let bottom = last.map_or(0, |last| {
        app.held.map_or(last, |held| lines.iter().rposition(|e| e.number <= held).unwrap_or(0))
    });
    let first = (bottom + 1).saturating_sub(room);
    let window = Window { first, page: room, lines: lines.len() };
    let canvas = &mut canvas.beside_scrollbar(1, window);
    let columns = columns(canvas.area.width);
    let widths = canvas.indented().widths(&columns);
    canvas.indented().titles(0, &columns, &widths);
    let Some(last) = last else {
        let text =
            if app.filter().is_empty() { " Nothing to report so far." } else { " No event has this text." };
        canvas.line(1, &[(text, Ink::Dim)]);
        return;
    };
    for (y, (i, entry)) in (1..).zip(lines.iter().enumerate().skip(first).take(room)) {
        let level = entry.level();
        let ink = match level {
            Severity::Trace => Ink::Dim,
            Severity::Note => Ink::Plain,
            Severity::Warn => Ink::Warn,
            Severity::Bad => Ink::Bad,
        };
        let ago = Span(now.saturating_sub(entry.first)).to_string();
        let (object, detail) = (entry.object(), times(entry, now) + &entry.detail());
        // Without a column for the node, an event without another object is about its node.
        let narrow = match object.as_str() {
            "" => format!("{} {detail}", entry.node),
            _ => format!("{object} {detail}"),
        };
        let mut cells = vec![(ago.as_str(), Ink::Dim), (mark(level), ink)];
        if widths.len() > 4 {
            cells.extend([(entry.node.shown(), Ink::Plain), (entry.kind(), ink)]);
            cells.extend([(object.as_str(), Ink::Plain), (detail.as_str(), ink)]);
        } else {
            cells.extend([(entry.kind(), ink), (narrow.as_str(), Ink::Plain)]);
        }
        canvas.indented().row(y, &columns, &widths, &cells);
        if i == bottom {
            canvas.cursor(y);
        }
        canvas.target(0, y, canvas.area.width, Hit::Line(i));
    }
    let newer = last - bottom;
    let key = |text: &str, action| (text.to_owned(), Some(Hit::Key(action)));
    let which = match (app.everything, app.discards_hidden) {
        (true, false) => key("every event, ", Action::Everything),
        (true, true) => key("every event but discards, ", Action::Discards),
        (false, true) => key("no discards, ", Action::Discards),
        (false, false) => key("", Action::Everything),
    };
    let follows = app.held.map_or("following ".to_owned(), |_| format!("+{newer} new, G follows "));
    let follows = key(&follows, Action::Last);
    let few = key(&app.held.map_or_else(String::new, |_| format!("+{newer} ")), Action::Last);
    let at = window.position(bottom);
    let texts =
        [vec![which, follows.clone(), at.clone()], vec![follows.clone(), at], vec![follows], vec![few]];
    canvas.corner(0, &texts, if app.held.is_some() { Ink::Warn } else { Ink::Dim });
}

/// The text before the details of an entry: how often the event occurred and, if it occurred repeatedly over some time,
/// when it last occurred.
fn times(entry: &Entry, now: Moment) -> String {
    let count = entry.count();
    if count.is_empty() {
        return count;
    }
    if entry.at.saturating_sub(entry.first) < Duration::from_secs(1) {
        return format!("{count}: ");
    }
    format!("{count}, last {} ago: ", Span(now.saturating_sub(entry.at)))
}
