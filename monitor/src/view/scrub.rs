//! The scrub bar above the bottom line, while the screen is paused or shows a recording: the whole length, the places
//! at which something went wrong, and the position shown. A click on the bar moves the position.

use super::canvas::{Canvas, columns};
use crate::app::App;
use crate::clock::Moment;
use crate::drawn::Hit;
use crate::keys::Action;
use crate::replay::{Ribbon, Trouble};
use crate::theme::Ink;
use std::borrow::Cow;

/// The hints at the keys of the bar, longest first.
const KEYS: [&str; 4] =
    ["  [ ] step  { } trouble  Home End  space ", "  [ ] { } space ", " [ ] { } space", ""];
/// A shorter bar would show no places.
const LEAST: u16 = 8;

/// The data that the scrub bar draws, and the shown position on it.
fn ribbon(app: &App, now: Moment) -> Option<(Cow<'_, Ribbon>, u64)> {
    if let Some(player) = app.replay() {
        let ribbon = Ribbon::of(player.film());
        let place = ribbon.place(player);
        return Some((Cow::Owned(ribbon), place));
    }
    // Frames go on arriving during a pause, but the bar is that of the moment of the pause.
    let ribbon = app.ribbon()?;
    let place = app.gone_back().map_or_else(|| ribbon.moment(now), |player| ribbon.place(player));
    Some((Cow::Borrowed(ribbon), place))
}

/// How many rows the bar takes on a screen of this height.
pub(super) fn rows(app: &App, height: u16) -> u16 {
    let is_shown = app.replay().is_some() || app.ribbon().is_some();
    u16::from(is_shown && height >= 8)
}

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let Some((ribbon, place)) = ribbon(app, now).filter(|_| canvas.height() > 0) else { return };
    let width = canvas.area.width;
    let (at, end) = ribbon.labels(place);
    // The text of the position has a fixed width, so that the bar stays in place when the position changes.
    let at = format!(" {at:>6} ");
    let end = format!(" {end}");
    let fixed = columns(&at) + columns(&end) + 2;
    let room = width.saturating_sub(fixed);
    // The longest hints would take half of a narrow row.
    let fits = |keys: &&&str| (width >= 100 || **keys != KEYS[0]) && columns(keys) + LEAST <= room;
    let keys = KEYS.iter().find(fits).copied().unwrap_or_default();
    let bar = room.saturating_sub(columns(keys));
    if bar < LEAST {
        canvas.target(0, 0, columns(&at), Hit::Key(Action::Oldest));
        canvas.target(columns(&at), 0, width, Hit::Key(Action::Newest));
        canvas.line(0, &[(&at, Ink::Plain), ("of", Ink::Dim), (&end, Ink::Plain)]);
        return;
    }
    let signs = app.theme.glyphs;
    let x = canvas.at(0, 0, u16::MAX, &at, Ink::Head);
    let start = canvas.at(x, 0, 1, "[", Ink::Dim);
    canvas.at(start, 0, bar, &signs.way.repeat(bar.into()), Ink::Dim);
    for (column, trouble) in ribbon.troubles(bar) {
        let (sign, ink) = if trouble == Trouble::Grave { ("!", Ink::Bad) } else { (":", Ink::Warn) };
        canvas.at(start + column, 0, 1, sign, ink);
    }
    canvas.at(start + ribbon.column(place, bar), 0, 1, signs.full, Ink::Head);
    for column in 0..bar {
        canvas.target(start + column, 0, 1, Hit::Scrub(ribbon.place_of(column, bar)));
    }
    let x = canvas.at(start + bar, 0, 1, "]", Ink::Dim);
    let x = canvas.at(x, 0, u16::MAX, &end, Ink::Plain);
    canvas.keys(x, 0, keys, KEYS_OF_TIME);
    canvas.at(x, 0, u16::MAX, keys, Ink::Dim);
    // The position before the bar and the length behind it lead to the two ends.
    canvas.target(0, 0, start, Hit::Key(Action::Oldest));
    canvas.target(start + bar, 0, x - start - bar, Hit::Key(Action::Newest));
}

/// The keys that move in time, as texts name them.
pub(super) const KEYS_OF_TIME: &[(&str, Action)] = &[
    ("[", Action::StepBack),
    ("]", Action::StepOn),
    ("{", Action::PreviousAnomaly),
    ("}", Action::NextAnomaly),
    ("Home", Action::Oldest),
    ("End", Action::Newest),
    ("space", Action::Pause),
];
