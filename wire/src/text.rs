//! Escapes untrusted text before a terminal shows it: names in a cell, fields of a recording, messages of another
//! program. Every screen and message calls [`acts`] to find the characters to escape. So no text moves the cursor,
//! changes a colour, reverses the writing direction or forges a line.

use std::borrow::Cow;
use std::fmt::Write as _;

/// Whether a terminal may act on a character instead of showing it. These are the control characters (C0, DEL, C1), and
/// the characters that change the writing direction, break lines or have no width.
#[must_use]
pub const fn acts(c: char) -> bool {
    matches!(c, '\0'..='\x1f' | '\x7f'..='\u{9f}' | '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}')
}

/// The text as one line: every character on which a terminal could act is escaped, line breaks included.
///
/// ```
/// assert_eq!(imrs_wire::text::one_line("nl\n\u{1b}[2Jnr"), "nl\\n\\u{1b}[2Jnr");
/// ```
#[must_use]
pub fn one_line(text: &str) -> Cow<'_, str> {
    if !text.contains(acts) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match acts(c) {
            true => out.extend(c.escape_default()),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}

/// JSON text in which every character on which a terminal could act is escaped; the values stay the same. Such
/// characters occur only inside JSON strings, where `\uXXXX` means the same character. Line breaks between values stay.
#[must_use]
pub fn json(json: &str) -> Cow<'_, str> {
    let acts = |c: char| acts(c) && c != '\n';
    if !json.contains(acts) {
        return Cow::Borrowed(json);
    }
    let mut out = String::with_capacity(json.len() + 16);
    for c in json.chars() {
        // All of these characters are in the Basic Multilingual Plane, so four digits suffice.
        match acts(c) {
            true => drop(write!(out, "\\u{:04x}", u32::from(c))),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}
