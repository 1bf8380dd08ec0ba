//! Draws text into a part of a buffer. Text is clipped at the edges, and no size causes a panic.

use crate::drawn::{Drawn, Hit};
use crate::keys::Action;
use crate::theme::{Ink, Theme};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Modifier, Style};

/// A part of the screen that can be drawn on.
pub(super) struct Canvas<'a> {
    pub buffer: &'a mut Buffer,
    pub area: Rect,
    pub theme: &'a Theme,
    /// The explained words of the screen: a piece of a line that begins with one is a title.
    pub words: &'static [(&'static str, &'static str)],
    /// The layout of the frame, to be filled while drawing.
    pub drawn: &'a mut Drawn,
}

/// A piece of a line: its text, its style, and what a click on it does.
pub(super) type Piece<'a> = (&'a str, Ink, Option<Hit>);

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub title: &'static str,
    /// The width in screen columns, without the gap after it. Columns with width 0 share the remaining width.
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

impl Canvas<'_> {
    /// The number of rows.
    pub(super) const fn height(&self) -> u16 {
        self.area.height
    }

    /// The part of this canvas below its first `rows` rows.
    pub(super) fn below(&mut self, rows: u16) -> Canvas<'_> {
        let rows = rows.min(self.area.height);
        let area = Rect { y: self.area.y + rows, height: self.area.height - rows, ..self.area };
        self.part(area)
    }

    /// Another part of the same buffer.
    pub(super) fn part(&mut self, area: Rect) -> Canvas<'_> {
        Canvas { buffer: self.buffer, area, theme: self.theme, words: self.words, drawn: self.drawn }
    }

    /// Makes `width` columns of a row a target of the mouse.
    pub(super) fn target(&mut self, x: u16, y: u16, width: u16, hit: Hit) {
        let area =
            Rect { x: self.area.x.saturating_add(x), y: self.area.y.saturating_add(y), width, height: 1 };
        let visible = area.intersection(self.area);
        if !visible.is_empty() {
            self.drawn.target(visible, hit);
        }
    }

    /// Notes how many lines the screen's list has, and how many have room.
    pub(super) const fn list(&mut self, page: usize, lines: usize) {
        (self.drawn.page, self.drawn.lines) = (page, lines);
    }

    /// Writes `text` at a column and row, at most `width` columns of it. Returns the column after it.
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

    /// Writes pieces in sequence. A piece that begins with an explained word is a target that explains it.
    pub(super) fn line(&mut self, y: u16, pieces: &[(&str, Ink)]) {
        let mut x = 0;
        for (text, ink) in pieces {
            let end = self.at(x, y, u16::MAX, text, *ink);
            self.explain(x, y, text);
            x = end;
        }
    }

    /// The explained word with which a text begins.
    fn word(&self, text: &str) -> Option<&'static str> {
        let begun = text.trim_start();
        let is_word = |word: &str| {
            begun.strip_prefix(word).is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
        };
        self.words.iter().find(|(word, _)| is_word(word)).map(|(word, _)| *word)
    }

    /// Makes a text that was written at a column and row a title, if it begins with an explained word that has none yet.
    pub(super) fn explain(&mut self, x: u16, y: u16, text: &str) {
        let Some(word) = self.word(text).filter(|word| !self.drawn.has_title(word)) else { return };
        let indent = columns(text).saturating_sub(columns(text.trim_start()));
        self.target(x.saturating_add(indent), y, columns(word), Hit::Column(word));
    }

    /// Writes a line of facts as [`Canvas::line`] does. A click on the text behind an explained word explains that word, too.
    pub(super) fn facts(&mut self, y: u16, pieces: &[Piece<'_>]) -> u16 {
        let (mut x, mut title) = (0, None);
        for (text, ink, hit) in pieces {
            let end = self.at(x, y, u16::MAX, text, *ink);
            self.explain(x, y, text);
            title = self.word(text).map(Hit::Column).or(title);
            if let Some(hit) = hit.or(title) {
                let indent = columns(text).saturating_sub(columns(text.trim_start()));
                self.target(x + indent, y, (end - x).saturating_sub(indent), hit);
            }
            x = end;
        }
        x
    }

    /// Makes the keys that a written text names targets, each with the words behind it.
    pub(super) fn keys(&mut self, x: u16, y: u16, text: &str, keys: &[(&str, Action)]) {
        let (mut at, mut last) = (x, None);
        for word in text.split_inclusive(' ') {
            let begun = word.trim_end();
            let known = keys.iter().find(|(key, _)| *key == begun.trim_end_matches([':', ',', ';']));
            last = known.map(|(_, action)| *action).or(last);
            if let Some(action) = last.filter(|_| !begun.is_empty()) {
                self.target(at, y, columns(word), Hit::Key(action));
            }
            at = at.saturating_add(columns(word));
        }
    }

    /// Marks the selected row by a sign and by its style, unless the cursor is on the banner.
    pub(super) fn cursor(&mut self, y: u16) {
        if self.drawn.is_on_banner {
            return;
        }
        self.at(0, y, 1, self.theme.glyphs.selected, Ink::Head);
        self.select(y);
    }

    /// The part of this canvas behind the column of the cursor.
    pub(super) fn indented(&mut self) -> Canvas<'_> {
        let indent = 1.min(self.area.width);
        self.part(Rect { x: self.area.x + indent, width: self.area.width - indent, ..self.area })
    }

    /// Highlights the selected row. The highlight replaces all other styles, so that the row has one colour.
    pub(super) fn select(&mut self, y: u16) {
        if y < self.area.height {
            let row = Rect { y: self.area.y + y, height: 1, ..self.area };
            self.buffer.set_style(row, self.theme.style(Ink::Selected));
        }
    }

    /// Gives a row of the culprit the alarm's style, reversed if the row is selected, so that it is the most striking row.
    pub(super) fn alarm(&mut self, y: u16, is_selected: bool) {
        if y < self.area.height {
            let row = Rect { y: self.area.y + y, height: 1, ..self.area };
            let style = Style::reset().patch(self.theme.style(Ink::Alarm));
            let is_reversed = style.add_modifier.contains(Modifier::REVERSED);
            let style = if is_selected && !is_reversed { style.reversed() } else { style };
            self.buffer.set_style(row, style);
        }
    }

    /// Writes the first of `texts` that fits into the free right end of a row. If none fits, the row stays as it is.
    /// Each text has parts, and a part may be a target.
    pub(super) fn corner(&mut self, y: u16, texts: &[Vec<(String, Option<Hit>)>], ink: Ink) {
        if y >= self.area.height {
            return;
        }
        let end = self.area.width;
        let is_free = |x: u16| self.buffer[(self.area.x + x, self.area.y + y)].symbol() == " ";
        let free = end - (0..end).rev().take_while(|&x| is_free(x)).last().unwrap_or(end);
        // One column stays free before the text.
        let long = |parts: &[(String, _)]| parts.iter().map(|(text, _)| columns(text)).sum::<u16>();
        let Some(parts) = texts.iter().find(|parts| long(parts) < free) else { return };
        let mut x = end - long(parts);
        for (text, hit) in parts {
            let start = x;
            x = self.at(x, y, u16::MAX, text, ink);
            self.explain(start, y, text);
            let area = Rect { x: self.area.x + start, y: self.area.y + y, width: x - start, height: 1 };
            if let Some(hit) = hit.filter(|_| !area.is_empty()) {
                // The title of the last column is a target up to the end of the row.
                self.drawn.target_above(area, hit);
            }
        }
    }

    /// The widths of `columns`.
    pub(super) fn widths(&self, columns: &[Column]) -> Vec<u16> {
        widths(columns, self.area.width)
    }

    /// Writes a row of a table.
    pub(super) fn row(&mut self, y: u16, columns: &[Column], widths: &[u16], cells: &[(&str, Ink)]) {
        let mut x = 0;
        for ((column, width), (text, ink)) in columns.iter().zip(widths).zip(cells) {
            let indent = if column.right { width.saturating_sub(self::columns(text)) } else { 0 };
            self.at(x + indent, y, width - indent, text, *ink);
            x = x.saturating_add(width + 1);
        }
    }

    /// Writes the titles of a table.
    pub(super) fn titles(&mut self, y: u16, columns: &[Column], widths: &[u16]) {
        let cells: Vec<_> = columns.iter().map(|c| (c.title, Ink::Dim)).collect();
        self.row(y, columns, widths, &cells);
        let mut x = 0_u16;
        for (column, width) in columns.iter().zip(widths) {
            self.target(x, y, *width, Hit::Column(column.title));
            x = x.saturating_add(width + 1);
        }
    }
}

/// How many columns of the screen a text takes: none for a combining character, two for a wide one.
pub(super) fn columns(text: &str) -> u16 {
    u16::try_from(ratatui::text::Span::raw(text).width()).unwrap_or(u16::MAX)
}

/// The beginning of a text that fits into `width` columns.
pub(super) fn cut(text: &str, width: u16) -> String {
    let (mut out, mut used) = (String::new(), 0);
    for c in text.chars() {
        used += columns(c.encode_utf8(&mut [0; 4]));
        if used > width {
            break;
        }
        out.push(c);
    }
    out
}

/// A text in exactly `width` columns: cut, or followed by spaces.
pub(super) fn fit(text: &str, width: u16) -> String {
    let out = cut(text, width);
    let spaces = width.saturating_sub(columns(&out));
    out + &" ".repeat(spaces.into())
}

/// The widths of `columns` if the table has a total of `width` screen columns.
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

/// A bar of `width` columns that shows `part` as a share of `whole`. A part above zero fills at least one column.
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

/// The first of `count` rows that is shown if `height` rows have room, so that `selected` is visible: lists scroll by pages.
pub(super) fn first_row(selected: usize, count: usize, height: usize) -> usize {
    let page = selected / height.max(1) * height.max(1);
    page.min(count.saturating_sub(height))
}
