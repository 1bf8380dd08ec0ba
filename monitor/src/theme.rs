//! The themes. A glyph or a word always carries the meaning, too; colour alone never does.

use ratatui::style::{Color, Modifier, Style};
use std::str::FromStr;

/// The meaning of a part of the screen, which determines its style.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Ordinary text.
    Plain,
    /// The header and headings.
    Head,
    /// Less important text: old state, units, hints.
    Dim,
    /// The selected row.
    Selected,
    /// A healthy state.
    Good,
    /// A warning.
    Warn,
    /// A critical finding.
    Bad,
    /// The block of the cell: the most striking style.
    Alarm,
    /// The remaining time in a bar.
    Bar,
}

/// The signs in rows and bars, each one column wide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Glyphs {
    /// The sign before the selected row.
    pub selected: &'static str,
    /// The sign before a row whose inner rows are shown.
    pub open: &'static str,
    /// The sign before a row whose inner rows are hidden.
    pub closed: &'static str,
    /// The sign before a dead node.
    pub dead: &'static str,
    /// The filled part of a bar.
    pub full: &'static str,
    /// The empty part of a bar.
    pub empty: &'static str,
    /// The sign in the matrix of arrivals if the member knows of the arrival.
    pub yes: &'static str,
    /// The sign in the matrix of arrivals if the member does not know of the arrival.
    pub no: &'static str,
    /// An arrow to the right, from one task to another.
    pub arrow: &'static str,
    /// An arrow to the left, from one task to another.
    pub back: &'static str,
    /// The line of a message between tasks of one node, timed by one clock.
    pub way: &'static str,
    /// The line of a message between nodes, whose clock offset is an estimate.
    pub guessed: &'static str,
    /// The line of a lane of the timeline.
    pub lane: &'static str,
    /// The mark of a rendezvous.
    pub met: &'static str,
    /// The mark of a rejection by rank.
    pub penalty: &'static str,
    /// The mark in a bar at the forecast of completion.
    pub done: &'static str,
    /// The part of a bar for the time until a rejected message is offered again.
    pub wait: &'static str,
    /// Columns of eight heights, from empty to full.
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
    wait: ":",
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
    wait: "╌",
    heights: ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"],
};

/// A set of styles and signs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Theme {
    /// The name of the theme, for the user.
    pub name: &'static str,
    /// The signs of the theme.
    pub glyphs: Glyphs,
    palette: Palette,
    own: Own,
}

/// The user's own colours, which replace those of a theme with colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Own([Option<Color>; Self::ROLES.len()]);

impl Own {
    /// No colours of the user.
    const NONE: Self = Self([None; Self::ROLES.len()]);
    /// The roles whose colour the user may choose, and their names in the settings file.
    pub const ROLES: [(Ink, &'static str); 7] = [
        (Ink::Head, "head"),
        (Ink::Dim, "dim"),
        (Ink::Good, "good"),
        (Ink::Warn, "warn"),
        (Ink::Bad, "bad"),
        (Ink::Alarm, "alarm"),
        (Ink::Bar, "bar"),
    ];

    /// Gives a role a colour. For an alarm this is the background colour.
    pub fn set(&mut self, ink: Ink, colour: Color) {
        if let Some(at) = Self::ROLES.iter().position(|(role, _)| *role == ink) {
            self.0[at] = Some(colour);
        }
    }

    fn of(&self, ink: Ink) -> Option<Color> {
        let at = Self::ROLES.iter().position(|(role, _)| *role == ink)?;
        self.0[at]
    }
}

/// The colours of a theme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Palette {
    /// No colours: only bold, dim, underlined and reversed text.
    None,
    /// Colours for a dark background.
    Dark,
    /// Colours for a light background.
    Light,
    /// The strongest colours on black, whatever the background of the terminal, and nothing dim.
    Contrast,
}

/// White and black, in the fixed part of the 256 colours.
const WHITE: u8 = 231;
const BLACK: u8 = 16;
/// The background of an alarm: red.
const ALARM: u8 = 160;

impl Theme {
    /// Colours that people with any colour vision can distinguish (Okabe and Ito), from the terminal's 256.
    pub const COLOUR: Self = Self { name: "colour", glyphs: UNICODE, palette: Palette::Dark, own: Own::NONE };
    /// No colour: bold, dim, underlined and reversed only.
    pub const MONO: Self = Self { name: "mono", glyphs: UNICODE, palette: Palette::None, own: Own::NONE };
    /// The theme without colour and with nothing but ASCII.
    pub const ASCII: Self = Self { name: "ascii", glyphs: ASCII, palette: Palette::None, own: Own::NONE };
    /// The theme with colour and nothing but ASCII.
    pub const COLOUR_ASCII: Self =
        Self { name: "colour-ascii", glyphs: ASCII, palette: Palette::Dark, own: Own::NONE };
    /// The colours of [`Self::COLOUR`], but darker, for a light background.
    pub const LIGHT: Self = Self { name: "light", glyphs: UNICODE, palette: Palette::Light, own: Own::NONE };
    /// The strongest colours and nothing dim, for poor eyesight or light.
    pub const CONTRAST: Self =
        Self { name: "contrast", glyphs: UNICODE, palette: Palette::Contrast, own: Own::NONE };
    /// All themes, in the order in which the theme key shows them.
    pub const ALL: [Self; 6] =
        [Self::COLOUR, Self::LIGHT, Self::CONTRAST, Self::MONO, Self::ASCII, Self::COLOUR_ASCII];

    /// The theme with this name.
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
        let at = Self::ALL.iter().position(|theme| theme.name == self.name).unwrap_or(0);
        Self::ALL[(at + 1) % Self::ALL.len()].with(self.own)
    }

    /// This theme with the user's own colours.
    #[must_use]
    pub const fn with(self, own: Own) -> Self {
        Self { own, ..self }
    }

    /// The theme `other` with the user's own colours of this theme.
    #[must_use]
    pub const fn changed_to(self, other: Self) -> Self {
        other.with(self.own)
    }

    /// The theme for a terminal with or without colour and UTF-8, and with a light or a dark background.
    #[must_use]
    pub const fn fitting(colour: bool, utf8: bool, light: bool) -> Self {
        match (colour, utf8, light) {
            (true, true, false) => Self::COLOUR,
            (true, true, true) => Self::LIGHT,
            (false, true, _) => Self::MONO,
            (true, false, false) => Self::COLOUR_ASCII,
            // There is no ASCII theme with colours for a light background.
            (false, false, _) | (true, false, true) => Self::ASCII,
        }
    }

    /// Whether a terminal that can show `other` can show this theme: it needs no colours and no signs that `other` does
    /// not need.
    #[must_use]
    pub fn needs_no_more_than(&self, other: &Self) -> bool {
        let has_colour = |theme: &Self| theme.palette != Palette::None;
        let has_signs = |theme: &Self| theme.glyphs == UNICODE;
        (!has_colour(self) || has_colour(other)) && (!has_signs(self) || has_signs(other))
    }

    /// The style of `ink`: in the user's own colour if there is one, unless the theme has no colours.
    #[must_use]
    pub fn style(&self, ink: Ink) -> Style {
        let style = self.plain_style(ink);
        match self.own.of(ink).filter(|_| self.palette != Palette::None) {
            Some(colour) if ink == Ink::Alarm => style.bg(colour),
            Some(colour) => style.fg(colour),
            None => style,
        }
    }

    fn plain_style(&self, ink: Ink) -> Style {
        let plain = Style::new();
        let modifier = |m: Modifier| plain.add_modifier(m);
        let colour = |index: u8| plain.fg(Color::Indexed(index));
        let bold = |index: u8| colour(index).add_modifier(Modifier::BOLD);
        let on_black = Style::new().fg(Color::Indexed(WHITE)).bg(Color::Indexed(BLACK));
        match (self.palette, ink) {
            (Palette::Contrast, Ink::Plain | Ink::Dim) => on_black,
            (Palette::Contrast, Ink::Selected) => {
                Style::reset().patch(on_black).add_modifier(Modifier::REVERSED)
            }
            (_, Ink::Plain) => plain,
            (_, Ink::Selected) => Style::reset().add_modifier(Modifier::REVERSED),
            (Palette::Dark | Palette::Light | Palette::Contrast, Ink::Alarm) => {
                bold(WHITE).bg(Color::Indexed(ALARM))
            }
            (Palette::None, Ink::Alarm) => modifier(Modifier::BOLD | Modifier::REVERSED),
            (Palette::Dark, Ink::Head) => bold(74),
            (Palette::Dark, Ink::Dim) => colour(245),
            (Palette::Dark, Ink::Good) => colour(36),
            (Palette::Dark, Ink::Warn) => colour(214),
            (Palette::Dark, Ink::Bad) => bold(202),
            (Palette::Dark, Ink::Bar) => colour(74),
            (Palette::Light, Ink::Head) => bold(25),
            (Palette::Light, Ink::Dim) => colour(241),
            (Palette::Light, Ink::Good) => colour(29),
            (Palette::Light, Ink::Warn) => colour(130),
            (Palette::Light, Ink::Bad) => bold(160),
            (Palette::Light, Ink::Bar) => colour(25),
            (Palette::Contrast, Ink::Head) => on_black.patch(bold(WHITE)).add_modifier(Modifier::UNDERLINED),
            (Palette::Contrast, Ink::Good) => on_black.patch(bold(46)),
            (Palette::Contrast, Ink::Warn) => on_black.patch(bold(226)),
            (Palette::Contrast, Ink::Bad) => bold(WHITE).bg(Color::Indexed(ALARM)),
            (Palette::Contrast, Ink::Bar) => on_black.patch(bold(51)),
            (Palette::None, Ink::Good | Ink::Bar) => plain,
            (Palette::None, Ink::Head) => modifier(Modifier::BOLD | Modifier::UNDERLINED),
            (Palette::None, Ink::Dim) => modifier(Modifier::DIM),
            (Palette::None, Ink::Warn) => modifier(Modifier::UNDERLINED),
            (Palette::None, Ink::Bad) => modifier(Modifier::BOLD),
        }
    }
}

impl FromStr for Theme {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = Self::names().join(", ");
        Self::named(name).ok_or_else(|| format!("no theme `{}`: there are {names}", crate::name::shown(name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INKS: [Ink; 9] = [
        Ink::Plain,
        Ink::Head,
        Ink::Dim,
        Ink::Selected,
        Ink::Good,
        Ink::Warn,
        Ink::Bad,
        Ink::Alarm,
        Ink::Bar,
    ];

    #[test]
    fn without_colour_nothing_is_coloured_and_the_selection_still_stands_out() {
        for theme in [Theme::MONO, Theme::ASCII] {
            for style in INKS.map(|ink| theme.style(ink)) {
                assert!([style.fg, style.bg].iter().all(|c| matches!(c, None | Some(Color::Reset))));
            }
            assert!(theme.style(Ink::Selected).add_modifier.contains(Modifier::REVERSED));
        }
    }

    /// A terminal's first eight colours and its default background belong to the user, so white text could be on a
    /// white background.
    #[test]
    fn the_contrast_theme_sets_both_text_and_background_everywhere() {
        for ink in INKS {
            let style = Theme::CONTRAST.style(ink);
            for colour in [style.fg, style.bg] {
                assert!(matches!(colour, Some(Color::Indexed(16..))), "{ink:?}: {style:?}");
            }
            assert_ne!(style.fg, style.bg);
        }
    }

    #[test]
    fn own_colours_replace_those_of_themes_with_colours() {
        let mut own = Own::default();
        own.set(Ink::Warn, Color::Rgb(1, 2, 3));
        own.set(Ink::Alarm, Color::Indexed(20));
        let theme = Theme::COLOUR.with(own);
        assert_eq!(theme.style(Ink::Warn).fg, Some(Color::Rgb(1, 2, 3)));
        assert_eq!(theme.style(Ink::Alarm).bg, Some(Color::Indexed(20)));
        assert_eq!(theme.style(Ink::Bad), Theme::COLOUR.style(Ink::Bad));
        assert_eq!(theme.next().style(Ink::Warn).fg, Some(Color::Rgb(1, 2, 3)));
        assert_eq!(Theme::MONO.with(own).style(Ink::Warn), Theme::MONO.style(Ink::Warn));
    }

    #[test]
    fn every_theme_is_found_by_its_name() {
        for (name, theme) in Theme::names().into_iter().zip(Theme::ALL) {
            assert_eq!(Theme::named(name), Some(theme));
        }
        assert_eq!(Theme::named("Colour"), None);
    }

    #[test]
    fn a_theme_is_shown_only_where_the_terminal_can() {
        for (theme, on, can) in [
            (Theme::LIGHT, Theme::COLOUR, true),
            (Theme::MONO, Theme::COLOUR, true),
            (Theme::COLOUR, Theme::MONO, false),
            (Theme::COLOUR, Theme::COLOUR_ASCII, false),
            (Theme::COLOUR_ASCII, Theme::ASCII, false),
            (Theme::ASCII, Theme::ASCII, true),
        ] {
            assert_eq!(theme.needs_no_more_than(&on), can, "{} on {}", theme.name, on.name);
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
