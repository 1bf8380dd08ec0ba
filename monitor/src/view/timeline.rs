//! Screen 4: the timeline. Each task has a lane, and time runs downwards. No effect is above its cause, and lines
//! between the lanes show messages.

use super::canvas::{Canvas, columns, cut};
use super::words::{ink, short};
use crate::app::App;
use crate::app::lanes::{Chart, Slice};
use crate::clock::Span;
use crate::store::timeline::{Mark, own_clock};
use crate::theme::Ink;
use std::time::Duration;

/// The width of the time axis.
const AXIS: u16 = 11;
/// The least width of a lane.
const LANE: u16 = 24;

pub(super) fn draw(app: &App, canvas: &mut Canvas<'_>) {
    let chart = app.chart();
    if chart.lanes.is_empty() {
        canvas.line(1, &[(" This cell has no tasks yet.", Ink::Plain)]);
        return;
    }
    let room = usize::from(canvas.height().saturating_sub(1));
    let first = (chart.bottom + 1).saturating_sub(room);
    canvas.list(room, chart.rows.len());
    let list = canvas.area.width < AXIS + LANE + 20;
    let sheet = Sheet::new(&chart, canvas.area.width);
    if list {
        canvas.line(0, &[("     TIME  TASK       WHAT", Ink::Dim)]);
    } else {
        sheet.heads(app, &chart, canvas);
    }
    let rows = chart.rows.iter().enumerate().skip(first).take(room);
    for (y, (at, row)) in (1..).zip(rows) {
        match row {
            Slice::Lost(gap) => {
                let node =
                    app.store().incarnation(gap.incarnation).map_or_else(String::new, |l| l.node.to_string());
                let text = format!("== lost {} events of {node} ", gap.lost);
                canvas.line(y, &[(&text, Ink::Warn), (&"=".repeat(200), Ink::Warn)]);
            }
            Slice::Quiet(time) => {
                let text = format!("  {}", Span(*time));
                let quiet = format!("{text:AXIS$} nothing", AXIS = usize::from(AXIS));
                canvas.line(y, &[(&quiet, Ink::Dim)]);
            }
            Slice::Marks(marks) => {
                let marks: Vec<&Mark> = marks.iter().map(|&i| &chart.timeline.marks[i]).collect();
                let (time, exact) = time(app, &chart, &marks);
                canvas.at(0, y, AXIS, &time, if exact { Ink::Plain } else { Ink::Dim });
                if list {
                    narrow(app, &marks, y, canvas);
                } else {
                    sheet.row(app, &chart, &marks, y, canvas);
                }
            }
        }
        if chart.held && at == chart.bottom {
            canvas.select(y);
        }
    }
    if chart.rows.is_empty() {
        canvas.line(1, &[(" Nothing has happened since the monitor attached.", Ink::Dim)]);
    }
    corner(app, &chart, canvas);
}

/// Shows at the right of the titles the zoom, and whether the screen follows new rows.
fn corner(app: &App, chart: &Chart, canvas: &mut Canvas<'_>) {
    let incarnations = chart.lanes.iter().filter_map(|task| app.incarnation_of_task(*task));
    let error = incarnations.filter_map(|incarnation| incarnation.clock).map(|clock| clock.error_us).max();
    let zoom = chart.zoom.map_or_else(|| "each event".to_owned(), |zoom| format!("{} a row", Span(zoom)));
    let zoom = if chart.sparse { format!("no ordinary messages, {zoom}") } else { zoom };
    let clocks =
        error.filter(|_| canvas.area.width >= 60).map(|us| format!("clocks +-{}, ", Span::micros(us)));
    let zoom = clocks.unwrap_or_default() + &zoom;
    let newer = chart.rows.len().saturating_sub(chart.bottom + 1);
    let text = if chart.held { format!(" {zoom}, +{newer} new, G follows ") } else { format!(" {zoom} ") };
    let x = canvas.area.width.saturating_sub(u16::try_from(text.len()).unwrap_or(0));
    canvas.at(x, 0, u16::MAX, &text, if chart.held { Ink::Warn } else { Ink::Dim });
}

/// The time of a row on the clock of the selected lane's node, since its start; and whether it is exact.
fn time(app: &App, chart: &Chart, marks: &[&Mark]) -> (String, bool) {
    let incarnation = chart.lanes.get(chart.lane).and_then(|task| app.incarnation_of_task(*task));
    let Some(incarnation) = incarnation else { return (String::new(), false) };
    let own = marks.iter().find(|mark| mark.incarnation == incarnation.id);
    let at = own.map(|mark| mark.at).or_else(|| marks.first().map(|mark| mark.order));
    let Some(us) = at.and_then(|at| own_clock(incarnation, at)) else { return (String::new(), false) };
    let at = Duration::from_micros(us);
    let (minutes, seconds) = (at.as_secs() / 60 % 60, at.as_secs() % 60);
    let text = format!("{minutes:2}:{seconds:02}.{:03}", at.subsec_millis());
    let sign = if own.is_some() { ' ' } else { '~' };
    (format!("{sign}{text}"), own.is_some())
}

fn narrow(app: &App, marks: &[&Mark], y: u16, canvas: &mut Canvas<'_>) {
    let Some(mark) = marks.first() else { return };
    let Some(incarnation) = app.store().incarnation(mark.incarnation) else { return };
    let more = if marks.len() > 1 { format!("+{} ", marks.len() - 1) } else { String::new() };
    let what = more + &short(mark, &incarnation.names, &app.theme);
    canvas.at(AXIS, y, 10, incarnation.names.task(mark.task).shown(), Ink::Plain);
    canvas.at(AXIS + 11, y, u16::MAX, &what, ink(mark.seen.what.event));
}

/// The layout of the lanes.
struct Sheet {
    first: usize,
    count: usize,
    width: u16,
}

impl Sheet {
    fn new(chart: &Chart, width: u16) -> Self {
        let room = width.saturating_sub(AXIS);
        let count = usize::from(room / LANE).clamp(1, chart.lanes.len().max(1));
        let first = (chart.lane + 1).saturating_sub(count);
        Self { first, count, width: room / u16::try_from(count).unwrap_or(1).max(1) }
    }

    /// The column of a lane, or of the edge if it is hidden, and whether it is visible.
    fn x(&self, lane: usize) -> (u16, bool) {
        let at = lane.saturating_sub(self.first).min(self.count);
        let x = AXIS + u16::try_from(at).unwrap_or(0).saturating_mul(self.width);
        (x, lane >= self.first && lane < self.first + self.count)
    }

    fn heads(&self, app: &App, chart: &Chart, canvas: &mut Canvas<'_>) {
        canvas.at(0, 0, AXIS, "     TIME", Ink::Dim);
        for (at, task) in chart.lanes.iter().enumerate().skip(self.first).take(self.count) {
            let (x, _) = self.x(at);
            let incarnation = app.incarnation_of_task(*task);
            let cell = app.cell();
            let names = cell.and_then(|cell| app.store().names(&cell).cloned());
            let name = names.map_or_else(String::new, |names| names.task(*task).to_string());
            let node = incarnation.map_or_else(String::new, |incarnation| format!("@{}", incarnation.node));
            let sign = if at == chart.lane { app.theme.glyphs.selected } else { " " };
            let inkling = if at == chart.lane { Ink::Head } else { Ink::Plain };
            let end = canvas.at(x.saturating_sub(1), 0, self.width, &format!("{sign}{name}"), inkling);
            canvas.at(end, 0, (x + self.width).saturating_sub(end + 1), &node, Ink::Dim);
        }
        let after = chart.lanes.len().saturating_sub(self.first + self.count);
        if self.first > 0 || after > 0 {
            let more = format!("{}{}", self.first, app.theme.glyphs.back);
            canvas.at(0, 0, 4, if self.first > 0 { &more } else { "" }, Ink::Warn);
        }
    }

    fn row(&self, app: &App, chart: &Chart, marks: &[&Mark], y: u16, canvas: &mut Canvas<'_>) {
        let mut taken = vec![false; usize::from(canvas.area.width)];
        for lane in self.first..self.first + self.count {
            canvas.at(self.x(lane).0, y, 1, app.theme.glyphs.lane, Ink::Dim);
        }
        let lane_of = |mark: &Mark| chart.lanes.iter().position(|task| *task == mark.task);
        for lane in self.first..self.first + self.count {
            let here: Vec<_> = marks.iter().filter(|mark| lane_of(mark) == Some(lane)).collect();
            let Some(mark) = here.first() else { continue };
            let Some(incarnation) = app.store().incarnation(mark.incarnation) else { continue };
            let (x, _) = self.x(lane);
            let room = self.width.saturating_sub(3);
            let text = several(here.iter().map(|mark| short(mark, &incarnation.names, &app.theme)), room);
            let worst = here.iter().map(|mark| ink(mark.seen.what.event)).max_by_key(|ink| match ink {
                Ink::Bad => 2,
                Ink::Warn => 1,
                _ => 0,
            });
            let end = canvas.at(x + 2, y, room, &text, worst.unwrap_or(Ink::Plain));
            mark_taken(&mut taken, x, end + 1);
        }
        for mark in marks {
            let cause = mark.cause.and_then(|cause| chart.timeline.marks.get(cause));
            if let (Some(to), Some(cause)) = (lane_of(mark), cause)
                && let Some(from) = lane_of(cause)
                && self.x(to).1
            {
                let sign = if cause.incarnation == mark.incarnation {
                    app.theme.glyphs.way
                } else {
                    app.theme.glyphs.guessed
                };
                self.way(app, (from, to), sign, y, &taken, canvas);
            }
        }
    }

    /// Draws the arrow of a message in the row of its arrival, around the text there.
    fn way(
        &self,
        app: &App,
        (from, to): (usize, usize),
        sign: &str,
        y: u16,
        taken: &[bool],
        canvas: &mut Canvas<'_>,
    ) {
        let (a, b) = (self.x(from).0, self.x(to).0);
        let free = |x: u16| !taken.get(usize::from(x)).copied().unwrap_or(true);
        if a < b {
            for x in (a + 1..b).filter(|&x| free(x)) {
                canvas.at(x, y, 1, if x + 1 == b { app.theme.glyphs.arrow } else { sign }, Ink::Dim);
            }
        } else {
            let start = (b..a).find(|&x| free(x)).map_or(a, |x| x + 1);
            for x in (start..a).filter(|&x| free(x)) {
                canvas.at(x, y, 1, if x == start { app.theme.glyphs.back } else { sign }, Ink::Dim);
            }
        }
    }
}

fn mark_taken(taken: &mut [bool], from: u16, to: u16) {
    for x in from..to {
        if let Some(cell) = taken.get_mut(usize::from(x)) {
            *cell = true;
        }
    }
}

/// Joins as many texts as fit, with the number of omitted ones. At least a part of the first one is shown.
fn several(texts: impl ExactSizeIterator<Item = String>, room: u16) -> String {
    let all = texts.len();
    let (mut out, mut shown) = (String::new(), 0);
    for text in texts {
        let width = columns(&out).saturating_add(columns(&text)).saturating_add(2);
        if shown > 0 && width + 4 > room {
            break;
        }
        if shown > 0 {
            out += "; ";
        }
        out += &text;
        shown += 1;
    }
    if shown == all {
        return cut(&out, room);
    }
    let more = format!(" +{}", all - shown);
    cut(&out, room.saturating_sub(columns(&more))) + &more
}
