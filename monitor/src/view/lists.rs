//! The common parts of lists: a scrollbar, the position, and sparklines.

use super::canvas::{Canvas, first_row};
use crate::drawn::Hit;
use crate::keys::Action;
use crate::theme::Ink;
use ratatui::layout::Rect;
use ratatui::symbols::bar;
use ratatui::widgets::{Scrollbar, ScrollbarOrientation, ScrollbarState, Sparkline, StatefulWidget, Widget};

/// Which part of a list is shown.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    /// The index of the first line that is shown.
    pub first: usize,
    /// How many lines have room.
    pub page: usize,
    /// How many lines the list has.
    pub lines: usize,
}

impl Window {
    /// Whether some lines have no room.
    pub(super) const fn is_partial(self) -> bool {
        self.lines > self.page
    }

    /// `37/156` for the line `at`; empty if all lines have room. A click on it shows the next page.
    pub(super) fn position(self, at: usize) -> (String, Option<Hit>) {
        let text = if self.is_partial() { format!("{}/{} ", at + 1, self.lines) } else { String::new() };
        (text, Some(Hit::Key(Action::PageDown)))
    }
}

impl Canvas<'_> {
    /// Draws the scrollbar of a list that begins at row `y`. Returns the part of the canvas beside the scrollbar.
    pub(super) fn beside_scrollbar(&mut self, y: u16, window: Window) -> Canvas<'_> {
        self.scrollbar(y, window);
        let width = self.area.width - u16::from(window.is_partial() && self.area.width > 1);
        self.part(Rect { width, ..self.area })
    }

    /// Notes a list in which the line `chosen` is selected, and for each line what Enter does on it. Returns which part of
    /// the list is shown, and the selected line.
    pub(super) fn chosen(&mut self, chosen: usize, page: usize, opens: Vec<Option<Hit>>) -> (Window, usize) {
        let lines = opens.len();
        self.list(page, lines);
        self.drawn.opens = opens;
        let at = chosen.min(lines.saturating_sub(1));
        (Window { first: first_row(at, lines, page), page, lines }, at)
    }

    /// Makes a drawn line of a list a target, and marks it if it is selected.
    pub(super) fn line_of(&mut self, y: u16, line: usize, selected: usize) {
        if line == selected {
            self.cursor(y);
        }
        self.target(0, y, self.area.width, Hit::Line(line));
    }

    /// Draws the scrollbar of a list that begins at row `y` into the last column, if not all lines have room. A click
    /// on the scrollbar moves the list.
    pub(super) fn scrollbar(&mut self, y: u16, window: Window) {
        let height = self.area.height.saturating_sub(y).min(u16::try_from(window.page).unwrap_or(u16::MAX));
        if !window.is_partial() || height < 2 || self.area.width < 2 {
            return;
        }
        let column = self.area.width - 1;
        let area = Rect { x: self.area.x + column, y: self.area.y + y, width: 1, height };
        let signs = self.theme.glyphs;
        let bar = Scrollbar::new(ScrollbarOrientation::VerticalRight)
            .begin_symbol(None)
            .end_symbol(None)
            .thumb_symbol(signs.full)
            .track_symbol(Some(signs.lane))
            .style(self.theme.style(Ink::Dim));
        let mut state = ScrollbarState::new(window.lines - window.page + 1)
            .position(window.first)
            .viewport_content_length(window.page);
        bar.render(area, self.buffer, &mut state);
        let last = usize::from(height - 1).max(1);
        for row in 0..height {
            let line = usize::from(row) * (window.lines - 1) / last;
            self.target(column, y + row, 1, Hit::Scroll(line));
        }
    }

    /// Draws the last of `values` as a sparkline at a column and row, the latest at the right. `None` leaves a gap. The full
    /// height is `most`; without it, the greatest of the values.
    pub(super) fn sparkline(
        &mut self,
        (x, y): (u16, u16),
        width: u16,
        values: &[Option<u64>],
        most: Option<u64>,
        ink: Ink,
    ) {
        if y >= self.area.height || x >= self.area.width {
            return;
        }
        let width = width.min(self.area.width - x);
        let shown = &values[values.len().saturating_sub(width.into())..];
        let used = u16::try_from(shown.len()).unwrap_or(width);
        let area = Rect { x: self.area.x + x + (width - used), y: self.area.y + y, width: used, height: 1 };
        let heights = self.theme.glyphs.heights;
        let set = bar::Set {
            empty: heights[0],
            one_eighth: heights[0],
            one_quarter: heights[1],
            three_eighths: heights[2],
            half: heights[3],
            five_eighths: heights[4],
            three_quarters: heights[5],
            seven_eighths: heights[6],
            full: heights[7],
        };
        let line = Sparkline::default()
            .data(shown.iter().copied())
            .bar_set(set)
            .absent_value_symbol(" ")
            .style(self.theme.style(ink));
        let line = if let Some(most) = most { line.max(most) } else { line };
        line.render(area, self.buffer);
    }
}
