//! Screen 4: the timeline. Each task has a lane, and time runs downwards. No effect is above its cause, and lines
//! between the lanes show messages.

use super::Hit;
use super::canvas::{Canvas, columns, cut, fit};
use super::lists::Window;
use super::words::{ink, short};
use crate::app::App;
use crate::app::lanes::{Chart, Slice};
use crate::clock::Span;
use crate::keys::Action;
use crate::store::journal::{Severity, level_of};
use crate::store::timeline::{Mark, since_start};
use crate::theme::Ink;
use std::time::Duration;

/// The width of the time axis, with the column of the cursor.
const AXIS: u16 = 11;
/// The least width of a lane.
const LANE: u16 = 24;

/// On a screen of at least this height, the text of the corner has a line of its own.
const TALL: u16 = 8;
/// How many rows below the screen are considered when the times on it are computed.
const BELOW: usize = 64;

pub(super) fn draw(app: &App, canvas: &mut Canvas<'_>) {
    let count = room_for(canvas.area.width);
    let chart = app.chart_of(count);
    canvas.drawn.lanes = count;
    if chart.lanes.is_empty() {
        canvas.line(1, &[(" This cell has no tasks yet.", Ink::Plain)]);
        return;
    }
    let above = u16::from(canvas.height() >= TALL);
    lanes(app, &chart, &mut canvas.below(above));
    corner(app, &chart, canvas);
}

/// Whether a screen of this width is too narrow for lanes, so that it lists the events of all lanes below each other.
const fn is_list(width: u16) -> bool {
    width < AXIS + LANE + 20
}

/// How many lanes have room beside each other.
fn room_for(width: u16) -> usize {
    if is_list(width) { usize::MAX } else { usize::from(width.saturating_sub(AXIS + 1) / LANE) }
}

fn lanes(app: &App, chart: &Chart, canvas: &mut Canvas<'_>) {
    let room = usize::from(canvas.height().saturating_sub(1));
    let first = (chart.bottom + 1).saturating_sub(room);
    canvas.list(room, chart.rows.len());
    let list = is_list(canvas.area.width);
    let window = Window { first, page: room, lines: chart.rows.len() };
    let whole = canvas.area;
    let canvas = &mut canvas.beside_scrollbar(1, window);
    let sheet = Sheet::new(chart, whole.width - u16::from(whole.width > 1));
    if list {
        canvas.line(0, &[("     TIME  ", Ink::Dim), ("TASK       ", Ink::Dim), ("WHAT", Ink::Dim)]);
    } else {
        sheet.heads(app, chart, canvas);
    }
    let times = times(app, chart, first, room + BELOW);
    let rows = chart.rows.iter().enumerate().skip(first).take(room);
    for (y, ((at, row), time)) in (1..).zip(rows.zip(times)) {
        match row {
            Slice::Lost(gap) => {
                let node =
                    app.store().incarnation(gap.incarnation).map_or_else(String::new, |l| l.node.to_string());
                let text = format!(" == lost {} events of {node} ", gap.lost);
                canvas.line(y, &[(&text, Ink::Warn), (&"=".repeat(200), Ink::Warn)]);
            }
            Slice::Quiet(time) => {
                let quiet = fit(&format!("  {}", Span(*time)), AXIS) + " nothing";
                canvas.line(y, &[(&quiet, Ink::Dim)]);
            }
            Slice::Marks(places) | Slice::Elsewhere(places) => {
                let marks: Vec<&Mark> = places.iter().map(|&i| &chart.timeline.marks[i]).collect();
                if let Some(time) = time {
                    let text = time.to_string();
                    // Beside the cursor, a long time is drawn without its last digit.
                    let text = if at == chart.bottom { format!("{:>10}", cut(text.trim(), 9)) } else { text };
                    canvas.at(0, y, AXIS, &text, if time.exact { Ink::Plain } else { Ink::Dim });
                }
                match row {
                    _ if list => narrow(app, &marks, y, canvas),
                    Slice::Elsewhere(_) => sheet.elsewhere(app, chart, &marks, y, canvas),
                    _ => sheet.row(app, chart, &marks, y, canvas),
                }
            }
        }
        if at == chart.bottom {
            canvas.cursor(y);
        }
        canvas.target(0, y, u16::MAX, Hit::Line(at));
    }
    if chart.rows.is_empty() {
        canvas.line(1, &[(" Nothing has happened since the monitor attached.", Ink::Dim)]);
    }
}

/// Writes the zoom into the corner above the lanes, and whether the screen follows new rows.
fn corner(app: &App, chart: &Chart, canvas: &mut Canvas<'_>) {
    let cell = app.cell();
    let incarnations = cell.iter().flat_map(|cell| app.store().present(cell));
    let error = incarnations.filter_map(|incarnation| incarnation.clock).map(|clock| clock.error_us).max();
    let key = |text: String, action| (text, Some(Hit::Key(action)));
    let zoom = chart.zoom.map_or_else(|| "each event".to_owned(), |zoom| format!("{} a row", Span(zoom)));
    let zoom = key(zoom, if app.is_widest() { Action::Closer } else { Action::Wider });
    let sparse = key(if chart.sparse { "no ordinary messages, " } else { "" }.to_owned(), Action::Everything);
    let clocks = error.map_or_else(String::new, |us| format!("clocks +-{}, ", Span::micros(us)));
    let clocks = (clocks, Some(Hit::Column("clocks")));
    let newer = chart.rows.len().saturating_sub(chart.bottom + 1);
    let (new, few) = if chart.held {
        (format!(", +{newer} new, G follows"), format!("+{newer} "))
    } else {
        (String::new(), String::new())
    };
    let (new, few) = (key(new, Action::Last), key(few, Action::Last));
    let room = usize::from(canvas.height().saturating_sub(1));
    let mut at = Window { first: 0, page: room, lines: chart.rows.len() }.position(chart.bottom);
    at.0 = if at.0.is_empty() { " ".to_owned() } else { format!("  {}", at.0) };
    let end = (" ".to_owned(), None);
    let texts = [
        vec![clocks, sparse.clone(), zoom.clone(), new.clone(), at.clone()],
        vec![sparse.clone(), zoom.clone(), new.clone(), at],
        vec![sparse, zoom, new, end],
        vec![few],
    ];
    canvas.corner(0, &texts, if chart.held { Ink::Warn } else { Ink::Dim });
}

/// The time of a row on the clock of the node of the selected lane.
#[derive(Clone, Copy)]
struct Time {
    /// Microseconds since the latest start of the node; negative before that start.
    us: i64,
    /// Whether the time comes from the node's own clock; otherwise it is an estimate.
    exact: bool,
}

impl std::fmt::Display for Time {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let at = Duration::from_micros(self.us.unsigned_abs());
        let (minus, sign) = (if self.us < 0 { "-" } else { "" }, if self.exact { "" } else { "~" });
        let (minutes, seconds) = (at.as_secs() / 60, at.as_secs() % 60);
        let text = if minutes < 60 {
            format!("{sign}{minus}{minutes}:{seconds:02}.{:03}", at.subsec_millis())
        } else {
            format!("{sign}{minus}{}:{:02}:{seconds:02}", minutes / 60, minutes % 60)
        };
        write!(f, "{text:>10}")
    }
}

/// The times of `count` rows from `first` on. The order of events on different nodes is an estimate, but an effect is
/// never above its cause. So if the clocks contradict the order, an estimated time is reduced to the times below it,
/// and the times never decrease downwards.
fn times(app: &App, chart: &Chart, first: usize, count: usize) -> Vec<Option<Time>> {
    let incarnation = chart.lanes.get(chart.lane).and_then(|task| app.incarnation_of_task(*task));
    let time = |row: &Slice| {
        let (marks, Some(incarnation)) = (row.marks(), incarnation) else { return None };
        let own = marks.iter().find(|&&at| chart.timeline.marks[at].incarnation == incarnation.id);
        let mark = &chart.timeline.marks[*own.or(marks.first())?];
        let us = since_start(incarnation, if own.is_some() { mark.at } else { mark.order })?;
        Some(Time { us, exact: own.is_some() })
    };
    let mut times: Vec<_> = chart.rows.iter().skip(first).take(count).map(time).collect();
    let mut below = i64::MAX;
    for time in times.iter_mut().rev().flatten() {
        if time.us > below {
            *time = Time { us: below, exact: false };
        }
        below = time.us;
    }
    times
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
        let (first, count) = (chart.shown.start, chart.shown.len());
        Self { first, count, width: room / u16::try_from(count).unwrap_or(1).max(1) }
    }

    /// The screen column of a lane, or of the edge if the lane is hidden. Also returns whether the lane is visible.
    fn x(&self, lane: usize) -> (u16, bool) {
        let at = lane.saturating_sub(self.first).min(self.count);
        let x = AXIS + u16::try_from(at).unwrap_or(0).saturating_mul(self.width);
        (x, lane >= self.first && lane < self.first + self.count)
    }

    fn heads(&self, app: &App, chart: &Chart, canvas: &mut Canvas<'_>) {
        canvas.line(0, &[("     TIME", Ink::Dim)]);
        let after = chart.lanes.len().saturating_sub(self.first + self.count);
        let more = format!(" {}{after}", app.theme.glyphs.arrow);
        let names = app.cell().and_then(|cell| app.store().names(&cell).cloned());
        for (at, task) in chart.lanes.iter().enumerate().skip(self.first).take(self.count) {
            let (x, _) = self.x(at);
            // The heading of the last visible lane leaves room for the number of hidden lanes to the right.
            let last = after > 0 && at + 1 == self.first + self.count;
            let width = if last { self.width.saturating_sub(columns(&more)) } else { self.width };
            let incarnation = app.incarnation_of_task(*task);
            let name = names.as_ref().map_or_else(String::new, |names| names.task(*task).to_string());
            let node = incarnation.map_or_else(String::new, |incarnation| format!("@{}", incarnation.node));
            let sign = if at == chart.lane { app.theme.glyphs.selected } else { " " };
            let inkling = if at == chart.lane { Ink::Head } else { Ink::Plain };
            let end = canvas.at(x.saturating_sub(1), 0, width, &format!("{sign}{name}"), inkling);
            canvas.at(end, 0, (x + width).saturating_sub(end + 1), &node, Ink::Dim);
            canvas.target(x.saturating_sub(1), 0, width, Hit::Lane(*task));
        }
        if self.first > 0 {
            let end = canvas.at(0, 0, 4, &format!("{}{}", self.first, app.theme.glyphs.back), Ink::Warn);
            canvas.target(0, 0, end, Hit::Lane(chart.lanes[self.first - 1]));
        }
        if after > 0 {
            let x = canvas.area.width.saturating_sub(columns(&more));
            canvas.at(x, 0, u16::MAX, &more, Ink::Warn);
            canvas.target(x, 0, columns(&more), Hit::Lane(chart.lanes[self.first + self.count]));
        }
    }

    fn row(&self, app: &App, chart: &Chart, marks: &[&Mark], y: u16, canvas: &mut Canvas<'_>) {
        let mut taken = vec![false; usize::from(canvas.area.width)];
        self.lines(app, y, canvas);
        let lane_of = |mark: &Mark| chart.lane_of(mark.task);
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
        self.beside(app, chart, marks, y, canvas);
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

    /// The hidden lanes of the marks to the left of the visible lanes, and those to the right.
    fn sides(&self, chart: &Chart, marks: &[&Mark]) -> (Vec<usize>, Vec<usize>) {
        let lanes = || marks.iter().filter_map(|mark| chart.lane_of(mark.task));
        let left = lanes().filter(|lane| *lane < self.first).collect();
        (left, lanes().filter(|lane| *lane >= self.first + self.count).collect())
    }

    /// Writes at the edges of a row how many of its events are in the hidden lanes on that side.
    fn beside(&self, app: &App, chart: &Chart, marks: &[&Mark], y: u16, canvas: &mut Canvas<'_>) {
        let (left, right) = self.sides(chart, marks);
        let lane = |lane: usize| Hit::Lane(chart.lanes[lane]);
        if let Some(nearest) = left.iter().max() {
            canvas.at(AXIS - 1, y, 1, app.theme.glyphs.back, Ink::Warn);
            canvas.target(AXIS - 1, y, 1, lane(*nearest));
        }
        if let Some(nearest) = right.iter().min() {
            let text = format!("+{}{}", right.len(), app.theme.glyphs.arrow);
            canvas.corner(y, &[vec![(text, Some(lane(*nearest)))]], Ink::Warn);
        }
    }

    /// Draws the lines of the lanes in a row.
    fn lines(&self, app: &App, y: u16, canvas: &mut Canvas<'_>) {
        for lane in self.first..self.first + self.count {
            canvas.at(self.x(lane).0, y, 1, app.theme.glyphs.lane, Ink::Dim);
        }
    }

    /// Draws a row whose marks are all in hidden lanes: its most severe event with the task, how many more events
    /// there are, and at which side their lanes are.
    fn elsewhere(&self, app: &App, chart: &Chart, marks: &[&Mark], y: u16, canvas: &mut Canvas<'_>) {
        self.lines(app, y, canvas);
        let worst = marks.iter().rev().max_by_key(|mark| level_of(mark.seen.what.event));
        let Some((mark, incarnation)) =
            worst.and_then(|mark| Some((mark, app.store().incarnation(mark.incarnation)?)))
        else {
            return;
        };
        let what = short(mark, &incarnation.names, &app.theme);
        let what = format!("{}: {what}", incarnation.names.task(mark.task));
        let is_bad = level_of(mark.seen.what.event) >= Severity::Warn;
        let text = match marks.len() {
            1 => what,
            all if is_bad => format!("+{all} elsewhere, {what}"),
            all => format!("+{all} elsewhere"),
        };
        let (left, right) = self.sides(chart, marks);
        let (back, arrow) = (app.theme.glyphs.back, app.theme.glyphs.arrow);
        let text = match (left.len(), right.len()) {
            (0, _) => format!("{text} {arrow}"),
            (_, 0) => format!("{back} {text}"),
            _ => format!("{back} {text} {arrow}"),
        };
        let room = canvas.area.width.saturating_sub(AXIS + 1);
        let end = room.saturating_sub(columns(&text));
        let x = match (left.len(), right.len()) {
            (0, _) => end,
            (_, 0) => 0,
            _ => end / 2,
        };
        canvas.at(AXIS + 1 + x, y, room, &text, if is_bad { ink(mark.seen.what.event) } else { Ink::Dim });
    }

    /// Draws the arrow of a message in the row of its arrival, around the text of that row.
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

/// Joins as many texts as fit, with the number of omitted ones. At least a part of the first text is shown.
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
