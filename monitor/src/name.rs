//! Names received from nodes. They are escaped, so that showing a name never moves the cursor, changes a colour or
//! reverses a line.

use imrs_wire::text::acts;
use std::fmt::{self, Write as _};
use std::sync::Arc;

/// The longest shown name, in characters.
const LONGEST: usize = 64;
/// The longest shown line, in characters.
const LONGEST_LINE: usize = 240;

/// A name, in the form received and in the form shown.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name {
    raw: Arc<str>,
    shown: Arc<str>,
}

impl Name {
    /// Makes a name from `raw`.
    #[must_use]
    pub fn new(raw: &str) -> Self {
        Self { raw: raw.into(), shown: shown(raw).into() }
    }

    /// The name exactly as received. Never print this on a terminal.
    #[must_use]
    pub fn raw(&self) -> &str {
        &self.raw
    }

    /// The name, escaped for a terminal and truncated.
    #[must_use]
    pub fn shown(&self) -> &str {
        &self.shown
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.shown)
    }
}

/// Escapes `text` for a terminal, and truncates it to a name's length.
#[must_use]
pub fn shown(text: &str) -> String {
    cut(text, LONGEST)
}

/// Escapes a line of text for a terminal, and truncates it.
#[must_use]
pub fn shown_line(text: &str) -> String {
    cut(text, LONGEST_LINE)
}

fn cut(text: &str, longest: usize) -> String {
    let mut out = String::new();
    for (i, c) in text.chars().enumerate() {
        if i == longest {
            out.push_str("..");
            break;
        }
        if !acts(c) {
            out.push(c);
        } else if u32::from(c) < 0x100 {
            let _ = write!(out, "\\x{:02x}", u32::from(c));
        } else {
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        }
    }
    out
}

/// The text of an error about a name that does not exist. It suggests the nearest name, or lists all names.
#[must_use]
pub fn unknown(what: &str, name: &str, names: &[&str]) -> String {
    let written = shown(name);
    let near = |known: &&&str| strsim::jaro_winkler(name, known);
    let best = names.iter().max_by(|a, b| near(a).total_cmp(&near(b))).filter(|best| near(best) > 0.7);
    match best {
        Some(best) => format!("no {what} `{written}`: did you mean `{best}`?"),
        None => format!("no {what} `{written}`: there are {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_a_terminal_acts_on_is_shown() {
        let name = Name::new("a\u{1b}[31m\u{9b}2J\u{202e}b\u{7f}\r\n\u{2066}é");
        assert_eq!(name.shown(), "a\\x1b[31m\\x9b2J\\u202eb\\x7f\\x0d\\x0a\\u2066é");
        assert_eq!(name.raw().chars().count(), 16);
        assert_eq!(shown(&"x".repeat(70)), "x".repeat(64) + "..");
    }

    #[test]
    fn json_keeps_its_values() {
        let text = serde_json::to_string("\u{1b}\u{9b}\u{202e}\"\n").unwrap();
        let escaped = imrs_wire::text::json(&text);
        assert!(escaped.is_ascii(), "{escaped}");
        assert_eq!(serde_json::from_str::<String>(&escaped).unwrap(), "\u{1b}\u{9b}\u{202e}\"\n");
    }
}
