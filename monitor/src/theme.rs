//! How things look. What something means is never said by colour alone: a glyph or a word says it too.

use ratatui::style::{Color, Modifier, Style};

/// What a piece of the screen is, from which its style follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Ordinary text.
    Plain,
    /// The line at the top, and headings.
    Head,
    /// What matters less: old state, units, hints.
    Dim,
    /// The row that keys act on.
    Selected,
    /// All well.
    Good,
    /// Look at this soon.
    Warn,
    /// Look at this now.
    Bad,
    /// Life that is left.
    Bar,
}

/// The signs that rows and bars are made of, each one column wide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Glyphs {
    /// Before the selected row.
    pub selected: &'static str,
    /// Before a row whose children are shown.
    pub open: &'static str,
    /// Before a row whose children are hidden.
    pub closed: &'static str,
    /// Before a dead node.
    pub dead: &'static str,
    /// What is left in a bar.
    pub full: &'static str,
    /// What is gone.
    pub empty: &'static str,
    /// Yes, in the matrix.
    pub yes: &'static str,
    /// Not yet, in the matrix.
    pub no: &'static str,
    /// Between two ends.
    pub arrow: &'static str,
    /// The same, to the left.
    pub back: &'static str,
    /// The way of a message between tasks of one node, whose clock measured it.
    pub way: &'static str,
    /// The way of a message between nodes, whose clocks are only estimated.
    pub guessed: &'static str,
    /// A task that lives on.
    pub lane: &'static str,
    /// A rendezvous.
    pub met: &'static str,
    /// Rejected, and ranked later.
    pub penalty: &'static str,
    /// In a bar: when the message will be done.
    pub done: &'static str,
    /// Heights, from nothing to full.
    pub heights: [&'static str; 8],
}

const ASCII: Glyphs = Glyphs {
    selected: ">",
    open: "-",
    closed: "+",
    dead: "x",
    full: "#",
    empty: ".",
    yes: "Y",
    no: ".",
    arrow: ">",
    back: "<",
    way: "-",
    guessed: "~",
    lane: "|",
    met: "*",
    penalty: "^",
    done: "|",
    heights: [".", "1", "2", "3", "4", "5", "6", "7"],
};

const UNICODE: Glyphs = Glyphs {
    selected: ">",
    open: "▾",
    closed: "▸",
    dead: "✗",
    full: "█",
    empty: "░",
    yes: "✓",
    no: "·",
    arrow: "→",
    back: "←",
    way: "─",
    guessed: "~",
    lane: "│",
    met: "◆",
    penalty: "↑",
    done: "┃",
    heights: ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"],
};

/// A set of styles and signs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Theme {
    /// Its name, for the user.
    pub name: &'static str,
    /// The signs.
    pub glyphs: Glyphs,
    colour: bool,
}

impl Theme {
    /// Colours that people with any colour vision tell apart (Okabe and Ito), from the 256 that terminals have.
    pub const COLOUR: Self = Self { name: "colour", glyphs: UNICODE, colour: true };
    /// No colour: bold, dim, underlined and reversed only.
    pub const MONO: Self = Self { name: "mono", glyphs: UNICODE, colour: false };
    /// No colour and nothing but ASCII.
    pub const ASCII: Self = Self { name: "ascii", glyphs: ASCII, colour: false };
    /// Colour, and nothing but ASCII.
    pub const COLOUR_ASCII: Self = Self { name: "colour-ascii", glyphs: ASCII, colour: true };
    /// All of them, in the order that the key for it goes through.
    pub const ALL: [Self; 4] = [Self::COLOUR, Self::MONO, Self::ASCII, Self::COLOUR_ASCII];

    /// The theme of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|theme| theme.name == name)
    }

    /// The names of all themes.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        Self::ALL.iter().map(|theme| theme.name).collect()
    }

    /// The theme after this one.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|t| *t == self).unwrap_or(0);
        Self::ALL[(at + 1) % Self::ALL.len()]
    }

    /// The theme for a terminal with or without colour and UTF-8.
    #[must_use]
    pub const fn fitting(colour: bool, utf8: bool) -> Self {
        match (colour, utf8) {
            (true, true) => Self::COLOUR,
            (false, true) => Self::MONO,
            (true, false) => Self::COLOUR_ASCII,
            (false, false) => Self::ASCII,
        }
    }

    /// The style of `ink`.
    #[must_use]
    pub fn style(&self, ink: Ink) -> Style {
        let plain = Style::new();
        let modifier = |m: Modifier| plain.add_modifier(m);
        if self.colour {
            return match ink {
                Ink::Plain => plain,
                Ink::Head => modifier(Modifier::BOLD).fg(Color::Indexed(74)),
                Ink::Dim => plain.fg(Color::Indexed(245)),
                Ink::Selected => modifier(Modifier::REVERSED),
                Ink::Good => plain.fg(Color::Indexed(36)),
                Ink::Warn => plain.fg(Color::Indexed(214)),
                Ink::Bad => modifier(Modifier::BOLD).fg(Color::Indexed(202)),
                Ink::Bar => plain.fg(Color::Indexed(74)),
            };
        }
        match ink {
            Ink::Plain | Ink::Good | Ink::Bar => plain,
            Ink::Head => modifier(Modifier::BOLD | Modifier::UNDERLINED),
            Ink::Dim => modifier(Modifier::DIM),
            Ink::Selected => modifier(Modifier::REVERSED),
            Ink::Warn => modifier(Modifier::UNDERLINED),
            Ink::Bad => modifier(Modifier::BOLD),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_colour_nothing_is_coloured_and_the_selection_still_stands_out() {
        let inks = [Ink::Plain, Ink::Head, Ink::Dim, Ink::Selected, Ink::Good, Ink::Warn, Ink::Bad, Ink::Bar];
        for theme in [Theme::MONO, Theme::ASCII] {
            for style in inks.map(|ink| theme.style(ink)) {
                assert!(style.fg.is_none() && style.bg.is_none());
            }
            assert!(theme.style(Ink::Selected).add_modifier.contains(Modifier::REVERSED));
        }
    }

    #[test]
    fn the_theme_key_goes_through_all_themes() {
        let mut theme = Theme::COLOUR;
        for _ in Theme::ALL {
            theme = theme.next();
        }
        assert_eq!(theme, Theme::COLOUR);
    }
}
