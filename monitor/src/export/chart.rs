//! Exports a recording as a sequence chart in SVG. Each task has a lane, time runs downwards, and an arrow leads from a
//! send to its effect.

use super::{ExportError, Exported, each_frame};
use crate::replay::Film;
use crate::store::Store;
use crate::store::journal::{Severity, level_of, word};
use crate::store::timeline::{Mark, Timeline, timeline};
use imrs_protocol::{Event, TaskId};
use imrs_wire::text::one_line;
use std::fmt::Write as _;
use std::io::Write;

/// The distance between two lanes, in pixels. The next two constants are the space left of the first lane, and the
/// distance between two marks.
const LANE: usize = 190;
const LEFT: usize = 110;
const LINE: usize = 16;
/// The space above the first mark, in pixels.
const TOP: usize = 3 * LINE;

const STYLE: &str = "text{font:12px monospace;fill:#333}.h{font-weight:bold}.t{fill:#888}.l{stroke:#bbb}\
 .a{stroke:#0072b2;fill:none;marker-end:url(#to)}.r{fill:#d55e00}.w{fill:#b06000}.m{fill:#555}\
 @media(prefers-color-scheme:dark){text{fill:#ddd}.t{fill:#999}.l{stroke:#555}.a{stroke:#56b4e9}.m{fill:#aaa}}";

pub(super) fn write(film: &Film, most: usize, mut out: impl Write) -> Result<Exported, ExportError> {
    let mut last = Store::default();
    each_frame(film, |store, _| {
        last = store.clone();
        Ok::<(), ExportError>(())
    })?;
    let Some(cell) = last.cells().into_iter().next() else { return Err(ExportError::Nothing("node")) };
    let Some(names) = last.names(&cell) else { return Err(ExportError::Nothing("names")) };
    let line = timeline(&last, &cell, most);
    let marks = newest(&line, most);
    if marks.is_empty() {
        return Err(ExportError::Nothing("events: record with the monitor's events on"));
    }
    let mut lanes: Vec<TaskId> = marks.iter().map(|(_, mark)| mark.task).collect();
    lanes.sort_unstable();
    lanes.dedup();
    let titles: Vec<String> = lanes.iter().map(|task| names.task(*task).to_string()).collect();
    let title = format!("{cell}: the last {} of what happened", marks.len());
    out.write_all(draw(&title, &lanes, &titles, &marks, names).as_bytes())?;
    out.flush()?;
    Ok(Exported { count: marks.len(), what: "marks" })
}

/// The newest marks, each with its index in the timeline.
fn newest(line: &Timeline, most: usize) -> Vec<(usize, &Mark)> {
    let first = line.marks.len().saturating_sub(most);
    line.marks.iter().enumerate().skip(first).collect()
}

fn draw(
    title: &str,
    lanes: &[TaskId],
    titles: &[String],
    marks: &[(usize, &Mark)],
    names: &crate::store::Names,
) -> String {
    let (width, height) = (LEFT + LANE * lanes.len(), TOP + LINE * (marks.len() + 2));
    let mut out = String::new();
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\"><title>{}</title><style>{STYLE}</style><defs><marker id=\"to\" viewBox=\"0 0 8 8\" \
         refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\"><path d=\"M0 0L8 4L0 8z\" \
         fill=\"#0072b2\"/></marker></defs>",
        escaped(title)
    );
    let x = |task: TaskId| LEFT + LANE * lanes.iter().position(|lane| *lane == task).unwrap_or(0);
    let first = marks.first().map_or(0, |(number, _)| *number);
    let y = |number: usize| TOP + LINE * (number - first + 1);
    for (lane, name) in lanes.iter().zip(titles) {
        let x = x(*lane);
        let _ = writeln!(out, "<text class=\"h\" x=\"{x}\" y=\"{}\">{}</text>", 2 * LINE, escaped(name));
        let _ = writeln!(
            out,
            "<line class=\"l\" x1=\"{x}\" y1=\"{}\" x2=\"{x}\" y2=\"{}\"/>",
            TOP,
            height - LINE
        );
    }
    for (number, mark) in marks {
        let cause = mark.cause.filter(|cause| *cause >= first);
        let from =
            cause.and_then(|cause| marks.get(cause - first)).map(|(at, cause)| (x(cause.task), y(*at)));
        if let Some((x1, y1)) = from {
            let _ = writeln!(
                out,
                "<line class=\"a\" x1=\"{x1}\" y1=\"{y1}\" x2=\"{}\" y2=\"{}\"/>",
                x(mark.task),
                y(*number)
            );
        }
    }
    let mut before = None;
    for (number, mark) in marks {
        let (x, y) = (x(mark.task), y(*number));
        let millis = mark.order.as_millis();
        if before.replace(millis) != Some(millis) {
            let _ = writeln!(
                out,
                "<text class=\"t\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{:.3}s</text>",
                LEFT - 20,
                y + 4,
                mark.order.as_secs_f64()
            );
        }
        let class = match level_of(mark.seen.what.event) {
            Severity::Bad => "r",
            Severity::Warn => "w",
            Severity::Note | Severity::Trace => "m",
        };
        let _ = writeln!(out, "<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"3\"/>");
        let _ = writeln!(
            out,
            "<text class=\"{class}\" x=\"{}\" y=\"{}\">{}</text>",
            x + 8,
            y + 4,
            escaped(&words(mark, names))
        );
    }
    out.push_str("</svg>\n");
    out
}

/// The label of a mark: `sent beat #12`, `expired beat #12`.
fn words(mark: &Mark, names: &crate::store::Names) -> String {
    let what = mark.seen.what;
    let event = match what.event {
        Event::Discarded(reason) => reason.name(),
        other => word(other),
    };
    let place = if mark.in_transit { " in transit" } else { "" };
    format!("{event} {} #{}{place}", names.port_name(what.port), what.number)
}

fn escaped(text: &str) -> String {
    one_line(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
