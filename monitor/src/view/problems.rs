//! Screen 8: everything that needs attention in one list over all nodes: findings under their causes, and the messages
//! nearest to missing their deadline.

use super::canvas::{Canvas, Column, first_row};
use super::lists::Window;
use super::{Hit, label, mark};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::problems::Problem;
use crate::store::blocked::Blocker;
use crate::store::health::{Finding, Place};
use crate::store::journal::Severity;
use crate::store::nearest::Near;
use crate::theme::Ink;

type Cells = [(String, Ink); 4];

fn columns(width: u16) -> Vec<Column> {
    let place = match width {
        0..60 => 12,
        60..100 => 20,
        _ => 30,
    };
    let mut columns = vec![Column::left("!", 2), Column::left("PLACE", place), Column::left("PROBLEM", 0)];
    if width >= 80 {
        columns.push(Column::left("CODE", 22));
    }
    columns
}

pub(super) fn draw(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let rows = app.problems(findings, blockers, now);
    let room = usize::from(canvas.height().saturating_sub(1));
    canvas.list(room, rows.len());
    let selected = app.problem(&rows);
    let window = Window { first: first_row(selected, rows.len(), room), page: room, lines: rows.len() };
    let canvas = &mut canvas.beside_scrollbar(1, window);
    let columns = columns(canvas.area.width);
    let mut inner = canvas.indented();
    let (area, widths) = (inner.area, inner.widths(&columns));
    inner.titles(0, &columns, &widths);
    canvas.corner(0, &[vec![window.position(selected)]], Ink::Head);
    if rows.is_empty() {
        canvas.line(1, &[(" Nothing is wrong, and no message waits.", Ink::Good)]);
        return;
    }
    for (y, (i, row)) in (1..).zip(rows.iter().enumerate().skip(window.first).take(room)) {
        let mut cells = cells(app, row);
        // The task and the port are more important than the node, if there is no room for all three.
        if canvas.area.width < 60
            && let Some((_, rest)) = cells[1].0.split_once('.')
        {
            let sign = if cells[1].0.starts_with(' ') { app.theme.glyphs.arrow } else { "" };
            cells[1].0 = format!("{sign}{rest}");
        }
        let cells: Vec<_> =
            cells.iter().take(columns.len()).map(|(text, ink)| (text.as_str(), *ink)).collect();
        canvas.part(area).row(y, &columns, &widths, &cells);
        if i == selected {
            canvas.cursor(y);
        }
        canvas.target(0, y, canvas.area.width, Hit::Problem(row.key()));
    }
}

fn cells(app: &App, row: &Problem) -> Cells {
    match row {
        Problem::Block(blocker) => {
            let text = format!("{} - holds {}: {}", blocker.name, blocker.by.len(), blocker.why);
            let ink = if blocker.level == Severity::Bad { Ink::Alarm } else { Ink::Warn };
            let sign = mark(blocker.level).to_owned();
            [(sign, ink), (label(app, blocker.place), ink), (text, ink), (blocker.code.to_owned(), Ink::Dim)]
        }
        Problem::Finding { finding, caused } => {
            let ink = match (finding.level, caused) {
                (Severity::Bad, false) => Ink::Bad,
                (Severity::Bad, true) | (Severity::Warn, _) => Ink::Warn,
                (Severity::Note | Severity::Trace, _) => Ink::Plain,
            };
            let place = label(app, finding.place);
            let place = if *caused { format!(" {} {place}", app.theme.glyphs.arrow) } else { place };
            let sign = mark(finding.level).to_owned();
            [
                (sign, ink),
                (place, Ink::Plain),
                (finding.text.to_string(), ink),
                (finding.code.to_owned(), Ink::Dim),
            ]
        }
        Problem::Message(near) => message(app, near),
    }
}

fn message(app: &App, near: &Near) -> Cells {
    let ink = if near.is_miss() { Ink::Bad } else { Ink::Plain };
    let names = app.store().incarnation(near.incarnation).map(|l| &l.names);
    let which = names.zip(near.message).map_or_else(
        || "its most urgent message".to_owned(),
        |(names, (source, id))| format!("#{id} of {}", names.task(source)),
    );
    let needs = match near.needs_us {
        Some(us) if near.is_miss() => format!(", MISS likely: needs {}", Span::micros(us)),
        Some(us) => format!(", needs {}", Span::micros(us)),
        None => String::new(),
    };
    let text = format!("{} left: {which}{needs}", near.left);
    let place = Place { node: Ok(near.incarnation), task: Some(near.task), port: Some(near.port) };
    let sign = if near.is_miss() { "!!" } else { "" };
    [
        (sign.to_owned(), ink),
        (label(app, place), Ink::Plain),
        (text, ink),
        ("next deadline".to_owned(), Ink::Dim),
    ]
}
