//! What every screen shows in addition if a recording is shown: the position in the recording, and the events of the step.

use super::canvas::Canvas;
use super::rendezvous::place_of;
use super::scrub::KEYS_OF_TIME;
use crate::app::App;
use crate::drawn::Hit;
use crate::keys::Action;
use crate::replay::{Player, tell};
use crate::theme::Ink;

/// The pieces of the header: the word REPLAY and the position.
pub(super) fn head(player: &Player, pieces: &mut Vec<(String, Ink, Option<Hit>)>) {
    let toggles = Some(Hit::Key(Action::Pause));
    pieces.push(("  REPLAY".to_owned(), Ink::Warn, toggles));
    let position = match (player.step(), &player.film().story) {
        (Some(step), Some(story)) => format!(" {}/{}", step.number, story.steps),
        _ => format!(" {}", player.position()),
    };
    pieces.push((position, Ink::Plain, toggles));
}

/// How many rows the panel with these lines takes on a screen of this height.
pub(super) fn rows(player: &Player, height: u16) -> u16 {
    match (player.step(), &player.film().notice) {
        (None, None) => 0,
        (None, Some(_)) => u16::from(height > 8),
        (Some(_), _) if height < 12 => height.saturating_sub(8).min(2),
        (Some(_), _) => (height / 3).min(14),
    }
}

/// A line of the panel: its text, its style, and what a click on it does.
type Line = (String, Ink, Option<Hit>);

/// Draws the panel: the events of the step, and the place in the cell's file.
pub(super) fn draw(app: &App, player: &Player, canvas: &mut Canvas<'_>) {
    let lines = lines(app, player);
    let room = usize::from(canvas.height());
    let shown = if lines.len() > room { room.saturating_sub(1) } else { lines.len() };
    let pages = lines.len().div_ceil(shown.max(1)).max(1);
    let first = player.panel_page() % pages * shown;
    for (y, (text, ink, hit)) in (0..).zip(lines.iter().skip(first).take(shown)) {
        canvas.at(0, y, u16::MAX, text, *ink);
        if let Some(hit) = hit {
            canvas.keys(0, y, text, KEYS_OF_TIME);
            canvas.target(0, y, u16::MAX, *hit);
        }
    }
    if lines.len() > shown {
        let y = u16::try_from(shown).unwrap_or(0);
        let key = app.keymap.label_of(Action::MoreOfStep);
        let text = match lines.len().saturating_sub(first + shown) {
            0 => format!("   ... {key}: from the first line on"),
            1 => format!("   ... 1 line more: {key}"),
            more => format!("   ... {more} lines more: {key}"),
        };
        canvas.at(0, y, u16::MAX, &text, Ink::Dim);
        canvas.target(0, y, u16::MAX, Hit::Key(Action::MoreOfStep));
    }
}

/// The lines of the panel, most important first.
fn lines(app: &App, player: &Player) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    if let Some(notice) = &player.film().notice {
        lines.push((format!(" ! {}", crate::name::shown(notice)), Ink::Warn, None));
    }
    let (Some(step), Some(story)) = (player.step(), &player.film().story) else { return lines };
    let rule = "-".repeat(usize::from(u8::MAX));
    let moves =
        if player.is_playing() { "playing, space stops" } else { "[ ] step  { } anomaly  space plays" };
    let head = format!("- step {} of {}, tick {}: {moves} {rule}", step.number, story.steps, step.tick);
    lines.push((head, Ink::Head, Some(Hit::Key(Action::Pause))));
    // The cause is seen at the end of the recording.
    let end = Some(Hit::Key(Action::Newest));
    if player.is_at_end() {
        lines.push((format!(" => {}", tell::cause(story)), Ink::Bad, end));
        if let Some(place) = tell::place(story) {
            lines.push((format!("    {place}"), Ink::Plain, None));
        }
    }
    let ink = if step.odd { Ink::Warn } else { Ink::Plain };
    lines.extend(step.happened.iter().map(|text| (format!(" {}", crate::name::shown_line(text)), ink, None)));
    if !player.is_at_end() {
        lines.push((format!(" => in the end: {}", tell::cause(story)), Ink::Dim, end));
        if let Some(place) = tell::place(story) {
            lines.push((format!("    {place}"), Ink::Dim, None));
        }
    }
    let cell = app.cell();
    let place = |task| Some(Hit::Place(place_of(app, cell.as_ref()?, task)?));
    lines.extend(tell::tasks(player).map(|(task, text)| (format!(" {text}"), Ink::Plain, place(task))));
    lines
}
