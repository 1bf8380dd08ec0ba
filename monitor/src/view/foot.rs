//! The bottom line: unusual facts or the finding of the selected row at the left, and the keys of the screen at the right.
//! Findings never displace the keys.

use super::canvas::{Canvas, columns};
use super::scrub::KEYS_OF_TIME;
use super::{before_pause, explain_column, mark, overview};
use crate::app::{App, Entry, Kind, Screen};
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::keys::Action;
use crate::problems::Problem;
use crate::store::blocked::Blocker;
use crate::store::health::{Finding, Place};
use crate::store::journal::Severity;
use crate::theme::Ink;
use ratatui::layout::Rect;

pub(super) fn draw(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let y = canvas.height() - 1;
    if let Some(entry) = &app.entry_line {
        line_typed(app, entry, y, canvas);
        return;
    }
    // The next key press or click removes an answer, so the answer may take the whole row.
    if let Some(told) = &app.told {
        canvas.line(y, &[(" ", Ink::Head), (told, Ink::Head)]);
        canvas.target(0, y, u16::MAX, Hit::Answer);
        return;
    }
    let help = Some(Hit::Key(Action::Show(Screen::Help)));
    let title = app.title().filter(|_| app.screen != Screen::Help);
    if let Some(text) = title.and_then(|title| explain_column(app.screen, title)) {
        let end = canvas.facts(y, &[(&format!(" {text} "), Ink::Head, help)]);
        let texts = [
            vec![("? in the help, ".to_owned(), help), ("Esc ".to_owned(), Some(Hit::Key(Action::Back)))],
            vec![("? help ".to_owned(), help)],
        ];
        let area = Rect { x: canvas.area.x + end, width: canvas.area.width - end, ..canvas.area };
        canvas.part(area).corner(y, &texts, Ink::Dim);
        return;
    }
    let width = canvas.area.width;
    let pieces = pieces(app, findings, blockers, width, now);
    let hints = hints(app, if pieces.is_empty() { width } else { width / 5 * 2 });
    let taken = hints.iter().map(|(hint, _)| columns(hint) + 2).sum::<u16>();
    let room = width.saturating_sub(taken);
    let mut x = room + 1;
    for (hint, action) in &hints {
        let end = canvas.at(x, y, u16::MAX, hint, Ink::Dim);
        canvas.target(x, y, end.saturating_sub(x), Hit::Key(*action));
        x = end + 2;
    }
    let mut area = canvas.part(Rect { width: room, ..canvas.area });
    let mut x = 0;
    for (text, ink, hit) in &pieces {
        // A cut text is drawn only if its first words have room; a few letters would say nothing.
        if x > 0 && columns(text).min(LEAST) > room.saturating_sub(x) {
            continue;
        }
        let end = area.at(x, y, u16::MAX, text, *ink);
        area.keys(x, y, text, KEYS_OF_TIME);
        area.target(x, y, end - x, *hit);
        x = end;
    }
}

/// Draws the line that the user types with its cursor, and behind it an error in the line or possible completions.
fn line_typed(app: &App, entry: &Entry, y: u16, canvas: &mut Canvas<'_>) {
    let sign = if entry.kind == Kind::Filter { " /" } else { " :" };
    let start = canvas.at(0, y, u16::MAX, sign, Ink::Head);
    let text = entry.input.value();
    // The text takes at most half of the row, so that an error in it has room, too.
    let room = canvas.area.width.saturating_sub(start + 1);
    let room = if columns(text) > room / 2 { room } else { room / 2 };
    let skipped = entry.input.visual_scroll(usize::from(room.max(1)));
    let (mut x, mut at, mut clicked) = (start, 0, 0);
    for (number, sign) in text.chars().chain([' ']).enumerate() {
        let width = columns(sign.encode_utf8(&mut [0; 4]));
        let is_here = number == entry.input.cursor();
        if at >= skipped && x < start + room + 1 {
            let is_end = number == text.chars().count();
            let sign = if is_end && is_here { "_".to_owned() } else { sign.to_string() };
            let ink = if is_here && !is_end { Ink::Selected } else { Ink::Plain };
            let end = canvas.at(x, y, u16::MAX, &sign, ink);
            canvas.target(clicked, y, end - clicked, Hit::Cursor(number));
            (x, clicked) = (end, end);
        }
        at += usize::from(width);
    }
    match app.slip() {
        Some(slip) => drop(canvas.at(x + 2, y, u16::MAX, &slip, Ink::Warn)),
        None => completions(app, x + 2, y, canvas),
    }
    // A click behind the text moves the cursor to the end of the text.
    canvas.target(x, y, u16::MAX, Hit::Cursor(text.chars().count()));
}

/// Writes the possible completions. A click on one of them takes it.
fn completions(app: &App, x: u16, y: u16, canvas: &mut Canvas<'_>) {
    let words = app.completion().words;
    let mut x = if words.is_empty() { x } else { canvas.at(x, y, u16::MAX, "Tab: ", Ink::Dim) };
    for (at, word) in words.iter().enumerate() {
        // A cut name would be another name.
        if at > 0 && x.saturating_add(columns(word)) > canvas.area.width {
            break;
        }
        let end = canvas.at(x, y, u16::MAX, word, Ink::Dim);
        canvas.target(x, y, end - x, Hit::Completion(at));
        x = end + 2;
    }
}

/// The least number of columns for a text behind another one.
const LEAST: u16 = 16;

/// As many hints at keys as fit; always the hint at the help.
fn hints(app: &App, width: u16) -> Vec<(String, Action)> {
    let mut chosen: Vec<(String, Action)> = Vec::new();
    let mut used = 0;
    for (hint, action) in app.keymap.hints(app.screen) {
        let gap = if chosen.is_empty() { 0 } else { 2 };
        if chosen.is_empty() || used + gap + columns(&hint) < width {
            used += gap + columns(&hint);
            chosen.push((hint, action));
        }
    }
    chosen
}

/// The unusual facts, each with what a click on it does: the mode of the screen, and the most severe finding.
fn pieces(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    width: u16,
    now: Moment,
) -> Vec<(String, Ink, Hit)> {
    let mut pieces: Vec<(String, Ink, Hit)> = Vec::new();
    if let Some((at, _)) = app.mark().filter(|_| app.since_mark) {
        let text = format!(" counters since the mark, {} ago; d ends it", Span(now.saturating_sub(at)));
        pieces.push((text, Ink::Warn, Hit::Key(Action::Difference)));
    }
    if let Some(at) = app.paused() {
        let text = match before_pause(app, now) {
            // The scrub bar names the keys that step, too.
            Some(before) if width < 110 => format!(" {} back; End returns, space goes on", Span(before)),
            Some(before) => {
                format!(" {} before the pause; [ ] step, End returns to it, space goes on", Span(before))
            }
            None => format!(" paused at {}; [ steps back, space goes on", Span(at)),
        };
        pieces.push((text, Ink::Warn, Hit::Key(Action::Pause)));
    }
    if let Some(file) = &app.recording {
        pieces.push((format!(" recording to {file}; r ends it"), Ink::Warn, Hit::Key(Action::Record)));
    }
    if !app.filter().is_empty() {
        pieces.push((format!(" filter /{}", app.filter()), Ink::Warn, Hit::Key(Action::Filter)));
    }
    if let Some(trouble) = app.store().troubles().next() {
        pieces.push((format!(" ! {trouble}"), Ink::Warn, Hit::Trouble));
        return pieces;
    }
    let chosen = chosen(app, findings, blockers, now);
    let worst = || Some((root(findings, blockers).filter(|f| f.level >= Severity::Warn)?, None));
    if let Some((finding, row)) = chosen.or_else(worst) {
        // The row already names its own place.
        let place = if row == Some(finding.place) { None } else { Some(overview::label(app, finding.place)) };
        let place = place.map_or_else(String::new, |place| format!("{place}: "));
        let ink = if finding.level == Severity::Bad { Ink::Bad } else { Ink::Warn };
        let text = format!(" {} {place}{}", mark(finding.level), finding.text);
        pieces.push((text, ink, Hit::Place(finding.place)));
    }
    pieces
}

/// The finding of the row that the user has selected, whose cell may have no room for all of it, and the place of that
/// row.
fn chosen<'a>(
    app: &App,
    findings: &'a [Finding],
    blockers: &[Blocker],
    now: Moment,
) -> Option<(&'a Finding, Option<Place>)> {
    match app.screen {
        Screen::Overview => {
            let row = app.chosen_row()?;
            Some((findings.iter().find(|finding| row.holds(&finding.place))?, Some(row)))
        }
        Screen::Problems => {
            let rows = app.problems(findings, blockers, now);
            let Problem::Finding { finding, .. } = rows.get(app.problem(&rows))? else { return None };
            let finding = findings.iter().find(|one| *one == finding)?;
            Some((finding, Some(finding.place)))
        }
        _ => None,
    }
}

/// The most severe finding that is no consequence of a block.
fn root<'a>(findings: &'a [Finding], blockers: &[Blocker]) -> Option<&'a Finding> {
    let is_root = |finding: &&Finding| !blockers.iter().any(|blocker| blocker.explains(finding));
    findings.iter().find(is_root).or_else(|| findings.first())
}
