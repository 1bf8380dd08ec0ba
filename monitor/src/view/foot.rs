//! The bottom line: what is unusual at the left, and the keys of the screen at the right. Findings never displace them.

use super::canvas::{Canvas, columns};
use super::{before_pause, mark, overview};
use crate::app::{App, Screen};
use crate::clock::{Moment, Span};
use crate::keys;
use crate::store::blocked::Blocker;
use crate::store::health::Finding;
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
    if app.typing {
        canvas.line(y, &[(" /", Ink::Head), (app.filter(), Ink::Plain), ("_", Ink::Plain)]);
        return;
    }
    if let Some(command) = &app.command {
        canvas.line(y, &[(" :", Ink::Head), (command, Ink::Plain), ("_", Ink::Plain)]);
        return;
    }
    // The next key removes an answer, so it may take the whole row.
    if let Some(told) = &app.told {
        canvas.line(y, &[(" ", Ink::Head), (told, Ink::Head)]);
        return;
    }
    let pieces = pieces(app, findings, blockers, now);
    let width = canvas.area.width;
    let hints = hints(app.screen, if pieces.is_empty() { width } else { width / 5 * 2 });
    let room = width.saturating_sub(columns(&hints) + 2);
    canvas.at(room + 1, y, u16::MAX, &hints, Ink::Dim);
    let area = Rect { width: room, ..canvas.area };
    let pieces: Vec<_> = pieces.iter().map(|(text, ink)| (text.as_str(), *ink)).collect();
    canvas.part(area).line(y, &pieces);
}

/// As many key hints as fit; the help always.
fn hints(screen: Screen, width: u16) -> String {
    let mut text = String::new();
    for hint in keys::hints(screen) {
        let gap = if text.is_empty() { "" } else { "  " };
        if text.is_empty() || columns(&text) + columns(gap) + columns(&hint) < width {
            text = text + gap + &hint;
        }
    }
    text
}

/// What is unusual: the mode of the screen, and the most severe finding.
fn pieces(app: &App, findings: &[Finding], blockers: &[Blocker], now: Moment) -> Vec<(String, Ink)> {
    let mut pieces: Vec<(String, Ink)> = Vec::new();
    if let Some((at, _)) = app.mark().filter(|_| app.since_mark) {
        pieces.push((
            format!(" counters since the mark, {} ago; d ends it", Span(now.saturating_sub(at))),
            Ink::Warn,
        ));
    }
    if let Some(at) = app.paused() {
        let text = match before_pause(app, now) {
            Some(before) => {
                format!(" {} before the pause; [ ] step, End returns to it, space goes on", Span(before))
            }
            None => format!(" paused at {}; [ steps back, space goes on", Span(at)),
        };
        pieces.push((text, Ink::Warn));
    }
    if let Some(file) = &app.recording {
        pieces.push((format!(" recording to {file}; r ends it"), Ink::Warn));
    }
    if !app.filter().is_empty() {
        pieces.push((format!(" filter /{}", app.filter()), Ink::Warn));
    }
    if let Some(trouble) = app.store().troubles().next() {
        pieces.push((format!(" ! {trouble}"), Ink::Warn));
    } else if let Some(worst) = root(findings, blockers).filter(|f| f.level >= Severity::Warn) {
        let place = overview::label(app, worst.place);
        let ink = if worst.level == Severity::Bad { Ink::Bad } else { Ink::Warn };
        pieces.push((format!(" {} {place}: {}", mark(worst.level), worst.text), ink));
    }
    pieces
}

/// The most severe finding that is no consequence of a block.
fn root<'a>(findings: &'a [Finding], blockers: &[Blocker]) -> Option<&'a Finding> {
    let is_root = |finding: &&Finding| !blockers.iter().any(|blocker| blocker.explains(finding));
    findings.iter().find(is_root).or_else(|| findings.first())
}
