//! Drawing lines of text into a buffer: everything is cut at the edge, nothing panics at any size.

use crate::theme::{Ink, Theme};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Modifier;

/// A part of the screen and how to draw on it.
pub(super) struct Pen<'a> {
    pub buffer: &'a mut Buffer,
    pub area: Rect,
    pub theme: &'a Theme,
}

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub title: &'static str,
    /// In columns of the screen, the gap after it not counted; 0: what is left, shared among such columns.
    pub width: u16,
    pub right: bool,
}

impl Column {
    pub(super) const fn left(title: &'static str, width: u16) -> Self {
        Self { title, width, right: false }
    }

    pub(super) const fn right(title: &'static str, width: u16) -> Self {
        Self { title, width, right: true }
    }
}

impl Pen<'_> {
    /// The rows of the part.
    pub(super) const fn height(&self) -> u16 {
        self.area.height
    }

    /// The same part without its first `rows` rows.
    pub(super) fn below(&mut self, rows: u16) -> Pen<'_> {
        let rows = rows.min(self.area.height);
        let area = Rect { y: self.area.y + rows, height: self.area.height - rows, ..self.area };
        Pen { buffer: self.buffer, area, theme: self.theme }
    }

    /// Writes `text` at a column and row of the part, at most `width` columns of it. Gives the column after it.
    pub(super) fn at(&mut self, x: u16, y: u16, width: u16, text: &str, ink: Ink) -> u16 {
        if y >= self.area.height || x >= self.area.width {
            return x;
        }
        let width = width.min(self.area.width - x);
        let style = self.theme.style(ink);
        let (end, _) =
            self.buffer.set_stringn(self.area.x + x, self.area.y + y, text, usize::from(width), style);
        end - self.area.x
    }

    /// Writes pieces one after the other.
    pub(super) fn line(&mut self, y: u16, pieces: &[(&str, Ink)]) {
        let mut x = 0;
        for (text, ink) in pieces {
            x = self.at(x, y, u16::MAX, text, *ink);
        }
    }

    /// Marks a row as the one that keys act on. All else that is said by style is taken from it, so that the mark is
    /// seen on every terminal.
    pub(super) fn select(&mut self, y: u16) {
        if y < self.area.height {
            let row = Rect { y: self.area.y + y, height: 1, ..self.area };
            self.buffer.set_style(row, self.theme.style(Ink::Selected).remove_modifier(Modifier::DIM));
        }
    }

    /// The widths that `columns` get.
    pub(super) fn widths(&self, columns: &[Column]) -> Vec<u16> {
        widths(columns, self.area.width)
    }

    /// Writes a row of a table.
    pub(super) fn row(&mut self, y: u16, columns: &[Column], widths: &[u16], cells: &[(&str, Ink)]) {
        let mut x = 0;
        for ((column, width), (text, ink)) in columns.iter().zip(widths).zip(cells) {
            let used = u16::try_from(ratatui::text::Span::raw(*text).width()).unwrap_or(u16::MAX);
            let indent = if column.right { width.saturating_sub(used) } else { 0 };
            self.at(x + indent, y, width - indent, text, *ink);
            x = x.saturating_add(width + 1);
        }
    }

    /// Writes the titles of a table.
    pub(super) fn titles(&mut self, y: u16, columns: &[Column], widths: &[u16]) {
        let cells: Vec<_> = columns.iter().map(|c| (c.title, Ink::Dim)).collect();
        self.row(y, columns, widths, &cells);
    }
}

/// The widths that `columns` get in `width`.
pub(super) fn widths(columns: &[Column], width: u16) -> Vec<u16> {
    let gaps = u16::try_from(columns.len().saturating_sub(1)).unwrap_or(0);
    let fixed: u16 = columns.iter().map(|c| c.width).sum();
    let open = columns.iter().filter(|c| c.width == 0).count();
    let left = width.saturating_sub(fixed + gaps);
    let share = left / u16::try_from(open).unwrap_or(1).max(1);
    let mut spare = left - share * u16::try_from(open).unwrap_or(0);
    let mut width = |c: &Column| {
        if c.width > 0 {
            return c.width;
        }
        share + std::mem::take(&mut spare)
    };
    columns.iter().map(&mut width).collect()
}

/// A bar of `width` columns of which `part` of `whole` is full. What is not nothing shows at least one full column.
pub(super) fn bar(theme: &Theme, width: u16, part: u64, whole: u64) -> String {
    let columns = u64::from(width);
    let full = if whole == 0 {
        0
    } else {
        (u128::from(part.min(whole)) * u128::from(columns)).div_ceil(whole.into())
    };
    let full = usize::try_from(full).unwrap_or(0).min(width.into());
    theme.glyphs.full.repeat(full) + &theme.glyphs.empty.repeat(usize::from(width) - full)
}

/// The first of `count` rows to show in `height`, so that `selected` is among them: screens turn like pages.
pub(super) fn first_row(selected: usize, count: usize, height: usize) -> usize {
    let page = selected / height.max(1) * height.max(1);
    page.min(count.saturating_sub(height))
}
