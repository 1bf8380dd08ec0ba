//! Screen 2: the queue of one port, most urgent message first, with the remaining time of each message.

use super::Hit;
use super::canvas::{Canvas, Column, bar, first_row};
use super::lists::Window;
use super::rendezvous::place_of;
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::keys::Action;
use crate::store::NodeIncarnation;
use crate::store::health::Place;
use crate::store::queue::{Waiting, queue};
use crate::store::service::{Service, Share, service};
use crate::theme::Ink;
use imrs_protocol::{Class, PortView, TaskId};
use ratatui::layout::Rect;

/// The number of rows above the table of messages. On a low screen these are only the description and the counters.
const fn above(height: u16) -> u16 {
    if height < 14 { 2 } else { 5 }
}

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let queues = app.queues();
    let Some(end) = app.port(&queues) else {
        canvas.line(1, &[(" No port of this cell receives messages.", Ink::Plain)]);
        return;
    };
    let Some(incarnation) = app.store().incarnation(end.incarnation) else { return };
    let Some(view) = incarnation.port(end.task, end.port) else { return };
    let info = incarnation.names.port(end.port);
    let at = queues
        .iter()
        .position(|q| *q == end)
        .map_or_else(String::new, |i| format!("{}/{}", i + 1, queues.len()));
    let above = above(canvas.height());
    about(app, incarnation, end.task, view, &at, now, canvas);
    counters(view, canvas);
    let served = service(app.store(), end.incarnation, end.task, end.port);
    if above > 2 {
        shares(incarnation, served.as_ref(), canvas);
        fill(view, served.as_ref(), canvas);
    }
    let whole =
        info.and_then(|i| i.time_out(end.task)).map_or(0, |t| t.0.saturating_mul(incarnation.tick_us));
    let waiting = queue(incarnation, end.task, end.port, now);
    bypassed(incarnation, end.task, end.port, canvas);
    let queue = Queue { app, incarnation, view, waiting, served: served.as_ref(), whole_us: whole };
    queue.draw(&mut canvas.below(above));
}

/// The label of figures that the monitor counts itself. The line above has the node's own counts since its start.
const SINCE_ATTACHED: &str = " since attached: ";

/// Draws the service times and the shares of the sources.
fn shares(incarnation: &NodeIncarnation, served: Option<&Service>, canvas: &mut Canvas<'_>) {
    let Some(served) = served else {
        canvas.facts(
            2,
            &[(SINCE_ATTACHED, Ink::Dim, None), ("service nothing seen of it yet", Ink::Dim, None)],
        );
        return;
    };
    let time = |us: Option<u64>| us.map_or_else(|| "-".to_owned(), |us| Span::micros(us).to_string());
    let svc = format!("service p50 {} p99 {}", time(served.p50_us), time(served.outlook.p99_us));
    let samples = format!(" of {}", served.samples);
    let mut pieces = vec![(SINCE_ATTACHED.to_owned(), Ink::Dim), (svc, Ink::Plain), (samples, Ink::Dim)];
    pieces.push(("  by source: ".to_owned(), Ink::Dim));
    if let Some(jain) = served.jain() {
        let ink = if jain < 0.8 { Ink::Warn } else { Ink::Plain };
        pieces.push((format!("Jain {jain:.2} "), ink));
    }
    let share = |(source, share): &(TaskId, Share)| {
        let rejected =
            if share.rejected > 0 { format!(", {} rejected", share.rejected) } else { String::new() };
        format!("{} {}/{}{rejected}", incarnation.names.task(*source), share.served, share.offered)
    };
    let each: Vec<_> = served.by_source.iter().map(share).collect();
    pieces.push((each.join("  "), Ink::Plain));
    let pieces: Vec<_> = pieces.iter().map(|(text, ink)| (text.as_str(), *ink, None)).collect();
    canvas.facts(2, &pieces);
}

/// Draws, for a watched port that competes with other ports, how often it was bypassed, and the limit of that (D58).
/// This is a present state, like the rest of the first row.
fn bypassed(
    incarnation: &NodeIncarnation,
    task: TaskId,
    port: imrs_protocol::PortId,
    canvas: &mut Canvas<'_>,
) {
    let Some(told) = incarnation.watched(task, port).filter(|told| told.what.queue.bypass_limit > 0) else {
        return;
    };
    let queue = &told.what.queue;
    let text = format!("bypassed {}/{} ", queue.bypassed, queue.bypass_limit);
    if canvas.area.width >= 100 {
        let near = queue.bypassed.saturating_mul(2) > queue.bypass_limit;
        let text = (text, Some(Hit::Column("bypassed")));
        canvas.corner(0, &[vec![text]], if near { Ink::Warn } else { Ink::Dim });
    }
}

/// Draws how many messages were queued over time, and the slack of the most urgent of them.
fn fill(view: &PortView, served: Option<&Service>, canvas: &mut Canvas<'_>) {
    let Some(served) = served else { return };
    let label = format!("last {} samples: ", served.fill.len());
    let room = usize::from(canvas.area.width.saturating_sub(56)).max(10);
    let values: Vec<_> = served.fill.iter().map(|len| Some(u64::from(*len))).collect();
    let width = u16::try_from(values.len().min(room)).unwrap_or(u16::MAX);
    let x = canvas.facts(3, &[(" fill ", Ink::Dim, None), (&label, Ink::Dim, None)]);
    canvas.sparkline((x, 3), width, &values, Some(view.capacity.max(1).into()), Ink::Bar);
    canvas.target(x, 3, width, Hit::Column("fill"));
    let time = |us: Option<u64>| us.map_or_else(|| "-".to_owned(), |us| Span::micros(us).to_string());
    let slack = format!("  slack p5 {} p50 {}", time(served.slack_p5_us), time(served.slack_p50_us));
    let end = (x + width).min(canvas.area.width);
    let rest = Rect { x: canvas.area.x + end, width: canvas.area.width - end, ..canvas.area };
    canvas.part(rest).facts(3, &[(&slack, Ink::Plain, None)]);
}

fn about(
    app: &App,
    incarnation: &NodeIncarnation,
    task: TaskId,
    view: &PortView,
    at: &str,
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let (presence, info) = (incarnation.presence(now), incarnation.names.port(view.port));
    let node = Place { node: Ok(incarnation.id), task: None, port: None };
    let own = Place { task: Some(task), ..node };
    let class = if view.class == Class::Command { "2" } else { "1" };
    let time_out =
        info.and_then(|i| i.time_out(task)).map(|t| Span::micros(t.0.saturating_mul(incarnation.tick_us)));
    let mut pieces = vec![
        (format!(" {}", incarnation.names.port_name(view.port)), Ink::Head, place_of_port(own, view)),
        (format!(" at {}@{}", incarnation.names.task(task), incarnation.node), Ink::Plain, at_place(own)),
    ];
    if presence.is_gone() {
        pieces.push((format!("  {presence}: last state"), Ink::Bad, at_place(node)));
    }
    pieces.push((format!("  buffer {}/{}", view.len, view.capacity), Ink::Plain, None));
    pieces.push((format!("  usage {}", view.usage), Ink::Dim, None));
    pieces.push((format!("  class {class}"), Ink::Dim, None));
    let users = info.map_or(&[][..], |i| &i.parties).iter().filter(|party| party.task != task);
    for (number, user) in users.enumerate() {
        let lead = if number == 0 { "  with " } else { "," };
        let place = place_of(app, &incarnation.names.cell, user.task).and_then(at_place);
        pieces.push((format!("{lead}{}", incarnation.names.task(user.task)), Ink::Dim, place));
    }
    if let Some(time_out) = time_out {
        pieces.push((format!("  time_out {time_out}"), Ink::Dim, None));
    }
    pieces.push(("  port ".to_owned(), Ink::Dim, None));
    pieces.push((at.to_owned(), Ink::Dim, Some(Hit::Key(Action::Right))));
    let pieces: Vec<_> = pieces.iter().map(|(text, ink, hit)| (text.as_str(), *ink, *hit)).collect();
    canvas.facts(0, &pieces);
}

const fn at_place(place: Place) -> Option<Hit> {
    Some(Hit::Place(place))
}

const fn place_of_port(task: Place, view: &PortView) -> Option<Hit> {
    at_place(Place { port: Some(view.port), ..task })
}

fn counters(view: &PortView, canvas: &mut Canvas<'_>) {
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
    let texts: Vec<_> = shown.map(|(_, (name, n))| format!("{name} {n}  ")).collect();
    let figures = texts.iter().map(|text| (text.as_str(), Ink::Plain, None));
    let pieces: Vec<_> = std::iter::once((" since start: ", Ink::Dim, None)).chain(figures).collect();
    canvas.facts(1, &pieces);
}

/// The queue of a port, with the data that decide about the verdicts on its messages.
struct Queue<'a> {
    app: &'a App,
    incarnation: &'a NodeIncarnation,
    view: &'a PortView,
    waiting: Vec<Waiting>,
    served: Option<&'a Service>,
    /// The TTL of a new message, in microseconds.
    whole_us: u64,
}

/// A message that was rejected by rank this often starves.
const STARVING: u32 = 3;

impl Queue<'_> {
    fn draw(&self, canvas: &mut Canvas<'_>) {
        let room = usize::from(canvas.height().saturating_sub(1));
        let selected = self.app.entry(&self.waiting);
        let lines = self.waiting.len();
        let window = Window { first: first_row(selected, lines, room), page: room, lines };
        let canvas = &mut canvas.beside_scrollbar(1, window);
        let width = canvas.area.width;
        let shown: &[usize] = match width {
            0..60 => &[0, 1, 4, 5],
            60..100 => &[0, 1, 2, 4, 5, 8],
            100..130 => &[0, 1, 2, 3, 4, 5, 7, 9, 8],
            _ => &[0, 1, 2, 3, 4, 5, 6, 7, 9, 8],
        };
        let columns: Vec<Column> = shown.iter().map(|&i| column(i, width)).collect();
        let mut inner = canvas.indented();
        let widths = inner.widths(&columns);
        inner.titles(0, &columns, &widths);
        if self.waiting.is_empty() {
            inner.line(1, &[("   - no message waits -", Ink::Dim)]);
            return;
        }
        let bar_at = shown.iter().position(|&i| i == 5).unwrap_or(0);
        let bar_width = widths.get(bar_at).map_or(0, |w| w.saturating_sub(2)).min(60);
        inner.list(room, lines);
        for (y, (i, waiting)) in (1..).zip(self.waiting.iter().enumerate().skip(window.first).take(room)) {
            let cells = self.cells(i, waiting, bar_width);
            let cells: Vec<_> = shown.iter().map(|&c| (cells[c].0.as_str(), cells[c].1)).collect();
            canvas.indented().row(y, &columns, &widths, &cells);
            if i == selected {
                canvas.cursor(y);
            }
            canvas.target(0, y, canvas.area.width, Hit::Entry(waiting.entry.source, waiting.entry.id));
        }
        self.hidden(window.first + room, canvas);
    }

    /// Shows at the right of the titles how many rows below have no room.
    fn hidden(&self, shown: usize, canvas: &mut Canvas<'_>) {
        let hidden = usize::from(self.view.len).max(self.waiting.len()).saturating_sub(shown);
        if hidden > 0 && canvas.height() > 0 {
            let down = |text: String| vec![(text, Some(Hit::Key(Action::PageDown)))];
            canvas.corner(0, &[down(format!("{hidden} more ")), down(format!("+{hidden}"))], Ink::Head);
        }
    }

    /// The cells of a message: place, source, id, class, time left, bar, age, rejections, verdict, back-off.
    fn cells(&self, at: usize, waiting: &Waiting, bar_width: u16) -> [(String, Ink); 10] {
        let (entry, left) = (&waiting.entry, waiting.left);
        let known = self.served.map_or(0, |s| s.rejections(entry.source, entry.id.sequence.get()));
        let rejected = waiting.held.map_or(known, |held| u32::from(held.rejections));
        let done_us = self.served.and_then(|served| served.outlook.done_in(at));
        let (verdict, ink) = self.verdict(at, waiting, done_us, rejected);
        let tight = if ink == Ink::Plain && left.us < self.whole_us / 10 { Ink::Warn } else { ink };
        let remain = if left.us == 0 { "expired".to_owned() } else { left.to_string() };
        let age = Span::micros(self.whole_us.saturating_sub(left.us)).to_string();
        let class = if entry.class == Class::Command { "2" } else { "1" };
        let penalty = match (waiting.held, waiting.back_off_us) {
            (None, _) => "?".to_owned(),
            (Some(_), 0) => "0".to_owned(),
            (Some(_), us) => format!("+{}", Span::micros(us)),
        };
        [
            ((at + 1).to_string(), Ink::Dim),
            (self.incarnation.names.task(entry.source).to_string(), Ink::Plain),
            (format!("#{}", entry.id), Ink::Dim),
            (class.to_owned(), Ink::Plain),
            (remain, tight),
            (self.bar(bar_width, waiting, done_us), if tight == Ink::Plain { Ink::Bar } else { tight }),
            (age, Ink::Dim),
            (rejected.to_string(), if rejected > 0 { Ink::Warn } else { Ink::Dim }),
            (verdict, ink),
            (penalty, if waiting.back_off_us > 0 { Ink::Warn } else { Ink::Dim }),
        ]
    }

    /// A bar: the remaining time, the time until a rejected message is offered again, and a mark at the forecast of
    /// completion.
    fn bar(&self, width: u16, waiting: &Waiting, done_us: Option<u64>) -> String {
        let signs = self.app.theme.glyphs;
        let incarnation = bar(&self.app.theme, width, waiting.left.us, self.whole_us);
        let waits = bar(&self.app.theme, width, waiting.back_off_us, self.whole_us);
        let place = |us: u64| {
            let at = u128::from(us) * u128::from(width) / u128::from(self.whole_us.max(1));
            usize::try_from(at).unwrap_or(usize::MAX).min(usize::from(width.saturating_sub(1)))
        };
        let done = done_us.filter(|_| self.whole_us > 0).map(place);
        let both = incarnation.chars().zip(waits.chars()).enumerate();
        let sign = |(at, (incarnation, waits)): (usize, (char, char))| match (
            done,
            signs.empty.contains(incarnation),
        ) {
            (Some(done), _) if done == at => signs.done.to_owned(),
            (_, true) if signs.full.contains(waits) => signs.wait.to_owned(),
            _ => incarnation.to_string(),
        };
        format!("[{}]", both.map(sign).collect::<String>())
    }

    fn verdict(&self, at: usize, waiting: &Waiting, done_us: Option<u64>, rejected: u32) -> (String, Ink) {
        let left_us = waiting.left.us;
        let status = waiting.entry.class == Class::Status;
        let full = self.view.len >= self.view.capacity && self.view.capacity > 0;
        // Only class-1 messages are evicted, the least urgent one first.
        let last = self.waiting.iter().rposition(|w| w.entry.class == Class::Status) == Some(at);
        let capped = waiting.held.is_some_and(|held| held.capped);
        match done_us {
            _ if left_us == 0 => ("expired".to_owned(), Ink::Bad),
            _ if waiting.back_off_us > left_us && !capped => {
                let text = format!("!! MISS: not offered for {}", Span::micros(waiting.back_off_us));
                (text, Ink::Bad)
            }
            Some(needs) if left_us < needs => {
                (format!("!! MISS likely: needs {}", Span::micros(needs)), Ink::Bad)
            }
            _ if capped => (format!("! {rejected} rejects: goes before all now"), Ink::Warn),
            _ if rejected >= STARVING => (format!("! starving: {rejected} rejects"), Ink::Warn),
            _ if full && last && status => ("! first to go: full".to_owned(), Ink::Warn),
            Some(_) => ("ok".to_owned(), Ink::Plain),
            None => ("-".to_owned(), Ink::Plain),
        }
    }
}

/// The columns, in the order of [`Queue::cells`].
const fn column(which: usize, width: u16) -> Column {
    let wide = width >= 100;
    match which {
        0 => Column::right("#", 2),
        1 => Column::left(
            "FROM",
            match width {
                0..60 => 8,
                60..100 => 10,
                100..120 => 12,
                _ => 16,
            },
        ),
        2 => Column::left("MSG", if wide { 12 } else { 9 }),
        3 => Column::left("CLS", 3),
        4 => Column::right("REMAIN", 8),
        5 => Column::left(
            "TIME LEFT",
            // On a narrow screen the bar is shortened first, because the words of the verdict are more important.
            match width {
                0..60 => 0,
                60..80 => 10,
                80..100 => 18,
                100..120 => 16,
                120..160 => 30,
                _ => 62,
            },
        ),
        6 => Column::right("AGE", 7),
        7 => Column::right("REJ", 4),
        9 => Column::right("PEN", 6),
        _ => Column::left("VERDICT", 0),
    }
}
