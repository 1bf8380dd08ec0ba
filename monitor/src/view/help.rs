//! The help, generated from the table of key bindings, so that it cannot be wrong. It starts with the bindings of the
//! screen from which it was opened.

use super::canvas::{self, Canvas};
use super::explained::{BANNER, HEADER, LISTS, columns};
use crate::app::{App, COMMANDS, Screen};
use crate::drawn::Hit;
use crate::keys::{Action, BINDINGS, Binding};
use crate::theme::{Ink, Theme};

/// A line of the help: the left text, the right text, the style of the right text, and what Enter does on the line.
type Line = (String, String, Ink, Option<Hit>);

pub(super) fn draw(app: &App, canvas: &mut Canvas<'_>) {
    let left_width = if canvas.area.width < 60 { 11 } else { 15 };
    // The scrollbar takes a column.
    let width = canvas.area.width.saturating_sub(left_width + 2);
    let widths = (left_width - 1, width);
    let asked = asked(app).map(|line| wrapped(line, widths)).unwrap_or_default();
    let lines: Vec<Line> =
        asked.iter().cloned().chain(lines(app).into_iter().flat_map(|line| wrapped(line, widths))).collect();
    let room = usize::from(canvas.height());
    let opens = lines.iter().map(|(.., hit)| *hit).collect();
    let (window, selected) = canvas.chosen(app.scroll, room, opens);
    let canvas = &mut canvas.beside_scrollbar(0, window);
    let rest = lines.len().saturating_sub(window.first + room);
    for (y, (at, (left, right, ink, _))) in (0..).zip(lines.iter().enumerate().skip(window.first).take(room))
    {
        if right.is_empty() {
            canvas.at(1, y, u16::MAX, left, *ink);
        } else {
            canvas.at(1, y, left_width - 1, left, if *ink == Ink::Head { Ink::Head } else { Ink::Plain });
            canvas.at(left_width + 1, y, u16::MAX, right, *ink);
        }
        if y == 0 && rest > 0 {
            let down = |text: String| vec![(text, Some(Hit::Key(Action::PageDown)))];
            let texts = [down(format!("{rest} more lines: j, PgDn ")), down(format!("{rest} more "))];
            canvas.corner(0, &texts, Ink::Head);
        }
        if at < asked.len() {
            canvas.select(y);
        }
        canvas.line_of(y, at, selected);
    }
}

/// The line about the title that is selected on the screen from which the help was opened.
fn asked(app: &App) -> Option<Line> {
    let title = app.title()?;
    let (name, text) = columns(app.helped()).iter().find(|(name, _)| *name == title)?;
    Some(((*name).to_owned(), (*text).to_owned(), Ink::Head, Some(Hit::Column(title))))
}

/// Wraps the right text of a line at `width` columns. A left text that is wider than its column gets a line of its
/// own above the right text.
fn wrapped((left, right, ink, hit): Line, (left_width, width): (u16, u16)) -> Vec<Line> {
    let is_above = !right.is_empty() && canvas::columns(&left) > left_width;
    let (above, left) = if is_above { (Some(left), String::new()) } else { (None, left) };
    let mut lines = vec![(left, String::new(), ink, hit)];
    for word in right.split(' ') {
        let last = lines.last_mut().expect("a line was begun");
        let needed = canvas::columns(&last.1).saturating_add(canvas::columns(word)).saturating_add(1);
        if !last.1.is_empty() && needed > width {
            lines.push((String::new(), word.to_owned(), ink, hit));
            continue;
        }
        if !last.1.is_empty() {
            last.1.push(' ');
        }
        last.1.push_str(word);
    }
    let above = above.map(|left| (left, String::new(), ink, hit));
    above.into_iter().chain(lines).collect()
}

/// All lines of the help.
fn lines(app: &App) -> Vec<Line> {
    let screen = app.helped();
    let mut lines = vec![heading(&format!("KEYS: {}", title(screen)))];
    let key = |b: &Binding| (app.keymap.label(b), b.help.to_owned(), Ink::Plain, Some(Hit::Key(b.action)));
    let here = |b: &&Binding| b.on.contains(&screen);
    let elsewhere = |b: &&Binding| !b.on.is_empty() && !b.on.contains(&screen);
    lines.extend(BINDINGS.iter().filter(here).map(key));
    lines.push(heading("KEYS EVERYWHERE"));
    lines.extend(BINDINGS.iter().filter(|b| b.on.is_empty()).map(key));
    lines.push(heading("COMMANDS, after a colon"));
    lines.extend(COMMANDS.iter().map(|(usage, help)| {
        let (word, rest) = usage.split_once(' ').map_or((*usage, ""), |(word, rest)| (word, rest));
        let help = if rest.is_empty() { (*help).to_owned() } else { format!("{rest}: {help}") };
        (format!(":{word}"), help, Ink::Plain, Some(Hit::Command(word)))
    }));
    lines.push(heading("SIGNS"));
    lines.extend(signs(&app.theme));
    lines.push(heading("COLOURS, never without a sign or a word"));
    lines.extend(colours(&app.theme));
    let text = |name: &str, text: &str, hit| (name.to_owned(), text.to_owned(), Ink::Plain, hit);
    let columns = columns(screen);
    if !columns.is_empty() {
        lines.push(heading(&format!("COLUMNS AND FIGURES: {}", title(screen))));
        lines.extend(columns.iter().map(|(name, told)| text(name, told, Some(Hit::Column(name)))));
    }
    lines.push(heading("LISTS AND NUMBERS"));
    lines.extend(LISTS.iter().map(|(name, told)| text(name, told, None)));
    lines.push(heading("THE HEADER"));
    lines.extend(HEADER.iter().map(|(name, told)| text(name, told, None)));
    lines.push(heading("THE BANNER, AND THE BOTTOM LINE"));
    lines.extend(BANNER.iter().map(|(name, told)| text(name, told, None)));
    lines.push(heading("KEYS ON OTHER SCREENS"));
    lines.extend(BINDINGS.iter().filter(elsewhere).map(|b| {
        let on: Vec<_> = b.on.iter().map(|screen| title(*screen)).collect();
        let hit = b.on.first().copied().map(leads_to);
        (app.keymap.label(b), format!("{}  ({})", b.help, on.join(", ")), Ink::Dim, hit)
    }));
    lines
}

/// What Enter does on a key of another screen: it opens that screen.
const fn leads_to(screen: Screen) -> Hit {
    match screen {
        // The settings are a window over a screen, so their own key opens them.
        Screen::Settings => Hit::Key(Action::Settings),
        screen => Hit::Tab(screen),
    }
}

fn heading(text: &str) -> Line {
    (text.to_owned(), String::new(), Ink::Head, None)
}

const fn title(screen: Screen) -> &'static str {
    match screen {
        Screen::Overview => "overview",
        Screen::Port => "port",
        Screen::Message => "message history",
        Screen::Rendezvous => "rendezvous",
        Screen::Timeline => "timeline",
        Screen::Timers => "timers",
        Screen::Events => "events",
        Screen::Model => "model",
        Screen::Problems => "problems",
        Screen::Explain => "explanation",
        Screen::Settings => "settings",
        Screen::Help => "help",
    }
}

fn signs(theme: &Theme) -> Vec<Line> {
    let signs = theme.glyphs;
    let two = |a: &str, b: &str| format!("{a} {b}");
    let line = |sign: String, text: &str, ink| (sign, text.to_owned(), ink, None);
    vec![
        line(signs.selected.to_owned(), "the row that keys act on", Ink::Plain),
        line(two(signs.open, signs.closed), "rows within are shown, hidden", Ink::Plain),
        line(signs.dead.to_owned(), "dead: the last state is kept; of a message: lost", Ink::Plain),
        line("?".to_owned(), "never seen by this monitor, or not known", Ink::Plain),
        line("!".to_owned(), "look at this soon", Ink::Warn),
        line("!!".to_owned(), "look at this now", Ink::Bad),
        line("~".to_owned(), "an estimate: an old sample, or clocks of two nodes", Ink::Plain),
        line(two(signs.full, signs.empty), "left, gone", Ink::Bar),
        line(
            signs.done.to_owned(),
            "in a bar: when it is likely done (99 of 100); less left is a miss",
            Ink::Bar,
        ),
        line(
            two(signs.heights[1], signs.heights[7]),
            "how full a buffer was, the latest at the right",
            Ink::Bar,
        ),
        line(two(signs.yes, signs.no), "knows of the arrival, does not (row of column)", Ink::Plain),
        line(two(signs.arrow, signs.back), "waits for; on the timeline: from, to", Ink::Plain),
        line(two(signs.way, signs.guessed), "a message's route: within a node, between nodes", Ink::Plain),
        line(two(signs.lane, signs.met), "a task; a rendezvous", Ink::Plain),
        line(signs.penalty.to_owned(), "rejected by rank; offered again, ranked higher", Ink::Plain),
        line(
            format!("{}{}", signs.way, signs.full),
            "the bar while paused or replaying: its length; this place is shown",
            Ink::Plain,
        ),
        line(
            "!".to_owned(),
            "on the bar: a node or task died, a link was cut, the model was violated",
            Ink::Bad,
        ),
        line(":".to_owned(), "on the bar: a time-out or the like", Ink::Warn),
        line("==".to_owned(), "events were lost here", Ink::Warn),
    ]
}

fn colours(theme: &Theme) -> Vec<Line> {
    let line =
        |sign: &str, text: &str, ink| (sign.to_owned(), format!("{text} (theme {})", theme.name), ink, None);
    vec![
        line("good", "all well", Ink::Good),
        line("warn", "soon, or not as it should be", Ink::Warn),
        line("bad", "now: a task waits in vain, or a node is dead", Ink::Bad),
        line("bar", "remaining time", Ink::Bar),
        line("dim", "of less weight, or old", Ink::Dim),
    ]
}
