//! The window with the settings of the running monitor, over the screen from which it was opened.

use super::canvas::{Canvas, columns};
use crate::app::{App, Setting};
use crate::drawn::Hit;
use crate::keys::Action;
use crate::theme::Ink;
use ratatui::layout::Rect;
use ratatui::symbols::border;
use ratatui::widgets::{Block, Clear, Widget};

/// The width of the window, if it has room.
const WIDTH: u16 = 76;
/// The width of the column with the values.
const VALUE: u16 = 14;

/// The border of the window for themes with nothing but ASCII.
const ASCII: border::Set<'static> = border::Set {
    top_left: "+",
    top_right: "+",
    bottom_left: "+",
    bottom_right: "+",
    vertical_left: "|",
    vertical_right: "|",
    horizontal_top: "-",
    horizontal_bottom: "-",
};

pub(super) fn draw(app: &App, canvas: &mut Canvas<'_>) {
    let whole = canvas.area;
    let lines = Setting::ALL.len();
    let wanted = u16::try_from(lines).unwrap_or(u16::MAX).saturating_add(2);
    let (width, height) = (whole.width.min(WIDTH), whole.height.min(wanted));
    let area = Rect {
        x: whole.x + (whole.width - width) / 2,
        y: whole.y + (whole.height - height) / 2,
        width,
        height,
    };
    let style = canvas.theme.style(Ink::Plain);
    Clear.render(area, canvas.buffer);
    canvas.buffer.set_style(area, style);
    let title = " settings: Enter changes, Esc closes ";
    let set = if canvas.theme.glyphs.full.is_ascii() { ASCII } else { border::PLAIN };
    Block::bordered().border_set(set).title(title).style(style).render(area, canvas.buffer);
    if width < 4 || height < 3 {
        return;
    }
    // A click on the window must not select anything behind it.
    canvas.drawn.forget(whole);
    canvas.part(area).keys(1, 0, title, &[("Enter", Action::Enter), ("Esc", Action::Back)]);
    let mut inner = canvas.part(Rect { x: area.x + 1, y: area.y + 1, width: width - 2, height: height - 2 });
    let room = usize::from(inner.height());
    let (window, selected) = inner.chosen(app.scroll, room, vec![None; lines]);
    for (y, (at, setting)) in (0..).zip(Setting::ALL.iter().enumerate().skip(window.first).take(room)) {
        let (long, short, key) = setting.about();
        let file = if key.is_empty() { String::new() } else { format!("  ({key})") };
        let room = inner.area.width.saturating_sub(VALUE + 1);
        let (about, file) = match room.checked_sub(columns(long)) {
            Some(rest) if rest >= columns(&file) => (long, file),
            Some(_) => (long, String::new()),
            None => (short, String::new()),
        };
        let value = app.setting(*setting);
        let ink = if value == "off" { Ink::Dim } else { Ink::Head };
        inner.at(2, y, VALUE - 2, value, ink);
        let end = inner.at(VALUE + 1, y, u16::MAX, about, Ink::Plain);
        inner.at(end, y, u16::MAX, &file, Ink::Dim);
        inner.line_of(y, at, selected);
    }
    // A click beside the window closes it.
    canvas.drawn.target(whole, Hit::Key(Action::Back));
}
