//! Draws the path to a finding as SVG.

use crate::chart::Note;
use std::fmt::Write;

/// The least and the greatest width of a lane, in pixels.
const LANE: (usize, usize) = (120, 360);
/// The width of a character, in tenths of a pixel.
const CHARACTER: usize = 73;
const LINE: usize = 18;
/// The width of the column of ticks, and of the column of line numbers beside it, if there is one.
const TICKS: usize = 60;
const LINES: usize = 50;

/// Draws the lines of a chart as SVG, one lane for each name. The drawing has no background of its own, so the background
/// of the page shows.
#[must_use]
pub fn svg<'a>(names: &[String], notes: impl IntoIterator<Item = &'a Note>, cause: &str) -> String {
    let notes: Vec<&Note> = notes.into_iter().collect();
    let lane = lane_width(&notes);
    let has_lines = notes.iter().any(|note| note.line().is_some());
    let left = TICKS + 10 + if has_lines { LINES } else { 0 };
    let lanes = left + lane * names.len().max(1);
    let (width, height) = (lanes.max(wide(cause) + 20), LINE * (notes.len() + 4));
    let mut out = String::new();
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"monospace\" font-size=\"12\" fill=\"#777\" stroke=\"none\">"
    );
    let x = |at: usize| left + lane * at + 10;
    let mut beside = |x: usize, y: usize, text: &str| {
        let _ = writeln!(out, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"end\">{text}</text>");
    };
    if has_lines {
        beside(TICKS, LINE, "tick");
        beside(TICKS + LINES, LINE, "line");
    }
    for (lane, name) in names.iter().enumerate() {
        let (x, end) = (x(lane), height - 2 * LINE);
        let _ = writeln!(out, "<text x=\"{x}\" y=\"{LINE}\" font-weight=\"bold\">{}</text>", escaped(name));
        let _ =
            writeln!(out, "<line x1=\"{x}\" y1=\"{}\" x2=\"{x}\" y2=\"{end}\" stroke=\"#999\"/>", LINE + 6);
    }
    let mut last = None;
    for (row, note) in notes.iter().enumerate() {
        let y = LINE * (row + 2);
        let tick = note.tick();
        if last != Some(tick) {
            let _ = writeln!(out, "<text x=\"{TICKS}\" y=\"{y}\" text-anchor=\"end\">{tick}</text>");
            last = Some(tick);
        }
        if let Some(line) = note.line() {
            let x = TICKS + LINES;
            let _ = writeln!(out, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"end\">{line}</text>");
        }
        draw(&mut out, note, y, x);
    }
    let _ =
        writeln!(out, "<text x=\"10\" y=\"{}\" font-weight=\"bold\">{}</text>", height - 8, escaped(cause));
    out.push_str("</svg>\n");
    out
}

/// The width of a text in pixels.
fn wide(text: &str) -> usize {
    text.chars().count() * CHARACTER / 10
}

/// The width of a lane, enough for the texts of events and for the labels of packets between two lanes.
fn lane_width(notes: &[&Note]) -> usize {
    let widest = notes.iter().map(|note| match note {
        Note::Event { text, .. } => wide(text) + 24,
        Note::Packet { label, outcome, .. } => wide(label) + wide(outcome) + 40,
        Note::Remark { .. } => 0,
    });
    widest.max().unwrap_or(0).clamp(LANE.0, LANE.1)
}

fn draw(out: &mut String, note: &Note, y: usize, x: impl Fn(usize) -> usize) {
    match note {
        Note::Event { lane, text, .. } => {
            let at = x(*lane);
            let _ = writeln!(out, "<circle cx=\"{at}\" cy=\"{}\" r=\"3\"/>", y - 4);
            let _ = writeln!(out, "<text x=\"{}\" y=\"{y}\">{}</text>", at + 8, escaped(text));
        }
        Note::Remark { text, .. } => {
            let _ = writeln!(out, "<text x=\"{}\" y=\"{y}\">{}</text>", x(0) + 8, escaped(text));
        }
        Note::Packet { from, to, label, outcome, .. } => {
            let (a, b) = (x(*from), x(*to));
            let (dash, colour) =
                if outcome.is_empty() { ("", "#5a8fd0") } else { (" stroke-dasharray=\"4 3\"", "#d0605a") };
            let _ = writeln!(
                out,
                "<line x1=\"{a}\" y1=\"{y}\" x2=\"{b}\" y2=\"{y}\" stroke=\"{colour}\"{dash}/>"
            );
            let tip = if a < b { b - 6 } else { b + 6 };
            let _ = writeln!(
                out,
                "<polygon points=\"{b},{y} {tip},{} {tip},{}\" fill=\"{colour}\"/>",
                y - 4,
                y + 4
            );
            let text = if outcome.is_empty() { label.clone() } else { format!("{label} {outcome}") };
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                usize::midpoint(a, b),
                y - 3,
                escaped(&text)
            );
        }
    }
}

fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}
