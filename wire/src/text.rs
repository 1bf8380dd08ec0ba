//! Texts that others wrote, on their way to a terminal: names in a cell, what a recording or a peer says. Whatever shows one
//! asks [`acts`] which characters to write out, so that none moves a cursor, changes a colour, reverses or forges a line (D151).

use std::borrow::Cow;
use std::fmt::Write as _;

/// Whether a terminal may act on a character instead of showing it: control characters (C0, DEL, C1), and what changes the
/// direction of writing, breaks lines or has no width.
#[must_use]
pub const fn acts(c: char) -> bool {
    matches!(c, '\0'..='\x1f' | '\x7f'..='\u{9f}' | '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}')
}

/// A text with everything written out that a terminal could act on, line breaks included: it is one line, whoever wrote it.
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

/// JSON text with every character in it escaped that a terminal could act on; the values stay the same. JSON has such
/// characters only in strings, where `\uXXXX` means the same; line breaks between values stay.
#[must_use]
pub fn json(json: &str) -> Cow<'_, str> {
    let acts = |c: char| acts(c) && c != '\n';
    if !json.contains(acts) {
        return Cow::Borrowed(json);
    }
    let mut out = String::with_capacity(json.len() + 16);
    for c in json.chars() {
        // All of them lie in the basic plane.
        match acts(c) {
            true => drop(write!(out, "\\u{:04x}", u32::from(c))),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}
