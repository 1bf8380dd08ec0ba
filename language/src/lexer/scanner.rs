//! The scanner: finds the next token of a text, the longest one that begins there.

use super::Kind;
use std::ops::Range;

/// Signs that [`Kind::describe`] writes as they are.
const SIGNS: [Kind; 25] = [
    Kind::Semicolon,
    Kind::Colon,
    Kind::Comma,
    Kind::Dot,
    Kind::DotDot,
    Kind::Assign,
    Kind::Arrow,
    Kind::BothWays,
    Kind::Link,
    Kind::Equal,
    Kind::NotEqual,
    Kind::Less,
    Kind::LessOrEqual,
    Kind::Greater,
    Kind::GreaterOrEqual,
    Kind::Plus,
    Kind::Minus,
    Kind::Times,
    Kind::Slash,
    Kind::ParenOpen,
    Kind::ParenClose,
    Kind::BraceOpen,
    Kind::BraceClose,
    Kind::BracketOpen,
    Kind::BracketClose,
];
/// Operators of other languages.
const FOREIGN: [&str; 10] = ["==", "!=", "&&", "||", "+=", "-=", "*=", "/=", "!", "%"];
/// Bytes of the longest sign.
const LONGEST_SIGN: usize = 3;

/// Goes through a text, token by token.
pub(crate) struct Scanner<'a> {
    text: &'a str,
    /// The token that was found last.
    token: Range<usize>,
}

impl<'a> Scanner<'a> {
    pub(crate) const fn new(text: &'a str) -> Self {
        Self { text, token: 0..0 }
    }

    /// The place of the token that was found last.
    pub(crate) fn span(&self) -> Range<usize> {
        self.token.clone()
    }

    /// The text of the token that was found last.
    pub(crate) fn slice(&self) -> &'a str {
        &self.text[self.token.clone()]
    }

    /// The text behind the token that was found last.
    pub(crate) fn remainder(&self) -> &'a str {
        &self.text[self.token.end..]
    }

    /// Makes the token that was found last longer by this many bytes.
    pub(crate) const fn bump(&mut self, bytes: usize) {
        self.token.end += bytes;
    }

    /// Finds the next token. The outer option is `None` at the end of the text; the inner one if the next character
    /// begins no token.
    pub(crate) fn next_token(&mut self) -> Option<Option<Kind>> {
        let blank = |c: char| matches!(c, ' ' | '\t' | '\r' | '\n' | '\x0C');
        let rest = self.remainder().trim_start_matches(blank);
        let first = rest.chars().next()?;
        let found = match first {
            '0'..='9' => Some(number(rest.as_bytes())),
            'A'..='Z' | 'a'..='z' | '_' => Some((Kind::Name, word(rest.as_bytes(), 0))),
            '"' | '\'' => Some(quoted(rest, first)),
            '/' if rest.starts_with("//") => Some((Kind::LineComment, rest.find('\n').unwrap_or(rest.len()))),
            _ => sign(rest),
        };
        let start = self.text.len() - rest.len();
        self.token = start..start + found.map_or(first.len_utf8(), |(_, length)| length);
        Some(found.map(|(kind, _)| kind))
    }
}

/// The longest sign at the beginning of a text.
fn sign(rest: &str) -> Option<(Kind, usize)> {
    (1..=LONGEST_SIGN).rev().find_map(|length| {
        let text = rest.get(..length)?;
        let kind = match text {
            "(*" | "/*" => Some(Kind::OpenComment),
            _ if FOREIGN.contains(&text) => Some(Kind::Foreign),
            _ => SIGNS.into_iter().find(|kind| kind.describe() == text),
        };
        kind.map(|kind| (kind, length))
    })
}

/// A text in quotes, which ends at its closing quote, or at the end of the line if there is none.
fn quoted(rest: &str, quote: char) -> (Kind, usize) {
    let ends = |c: char| c == quote || c == '\n';
    let end = rest[1..].find(ends).map_or(rest.len(), |end| end + 1);
    let is_closed = rest[end..].starts_with(quote);
    let length = end + usize::from(is_closed);
    match (quote, is_closed) {
        ('"', true) => (Kind::Text, length),
        ('"', false) => (Kind::OpenText, length),
        _ => (Kind::SingleQuotes, length),
    }
}

/// A token that begins with a digit: the longest of a whole number, a real number, and a wrong number, which contains
/// letters.
fn number(text: &[u8]) -> (Kind, usize) {
    let whole = digits(text, 0);
    let real = match text.get(whole..) {
        Some([b'.', b'0'..=b'9', ..]) => {
            let end = digits(text, whole + 1);
            Some(exponent(text, end).unwrap_or(end))
        }
        _ => exponent(text, whole),
    };
    let (kind, length) = real.map_or((Kind::Int, whole), |end| (Kind::Real, end));
    match bad_number(text) {
        Some(bad) if bad > length => (Kind::BadNumber, bad),
        _ => (kind, length),
    }
}

/// The end of a row of digits that begins at `at`. Between two digits there may be one `_`.
fn digits(text: &[u8], mut at: usize) -> usize {
    loop {
        at += 1;
        match text.get(at..) {
            Some([b'0'..=b'9', ..]) => {}
            Some([b'_', b'0'..=b'9', ..]) => at += 1,
            _ => return at,
        }
    }
}

/// The end of the exponent that begins at `at`, if there is one.
fn exponent(text: &[u8], at: usize) -> Option<usize> {
    let first = match text.get(at..)? {
        [b'e' | b'E', b'+' | b'-', b'0'..=b'9', ..] => at + 2,
        [b'e' | b'E', b'0'..=b'9', ..] => at + 1,
        _ => return None,
    };
    Some(first + text[first..].iter().take_while(|byte| byte.is_ascii_digit()).count())
}

/// The end of the word of letters, digits and `_` that begins at `at`.
fn word(text: &[u8], at: usize) -> usize {
    at + text[at..].iter().take_while(|byte| byte.is_ascii_alphanumeric() || **byte == b'_').count()
}

/// The length of a number that is wrong because of a letter or a superfluous `_`, before or behind the decimal point.
fn bad_number(text: &[u8]) -> Option<usize> {
    let has_more = |from: usize, to: usize| text[from + 1..to].iter().any(|byte| !byte.is_ascii_digit());
    let end = word(text, 0);
    let is_loose = text[..end].iter().all(|byte| byte.is_ascii_digit() || *byte == b'_');
    let behind = match text.get(end..) {
        Some([b'.', b'0'..=b'9', ..]) if is_loose => Some((end + 1, word(text, end + 1))),
        _ => None,
    };
    let behind = behind.filter(|&(from, to)| has_more(from, to)).map(|(_, to)| to);
    behind.or_else(|| has_more(0, end).then_some(end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use Kind::{BadNumber, Dot, DotDot, Int, Name, Real};

    fn scanned(text: &str) -> Vec<(Option<Kind>, &str)> {
        let mut scanner = Scanner::new(text);
        std::iter::from_fn(|| scanner.next_token().map(|kind| (kind, scanner.slice()))).collect()
    }

    fn kinds(text: &str) -> Vec<Option<Kind>> {
        scanned(text).into_iter().map(|(kind, _)| kind).collect()
    }

    #[test]
    fn the_longest_number_is_taken_and_what_is_none_goes_to_its_end() {
        for (text, found) in [
            ("1_000", &[(Int, "1_000")][..]),
            ("1.5e-3", &[(Real, "1.5e-3")]),
            ("1e5", &[(Real, "1e5")]),
            ("1_0.2_5E+7", &[(Real, "1_0.2_5E+7")]),
            ("1..2", &[(Int, "1"), (DotDot, ".."), (Int, "2")]),
            ("1.x", &[(Int, "1"), (Dot, "."), (Name, "x")]),
            ("12ab", &[(BadNumber, "12ab")]),
            ("1e5x", &[(BadNumber, "1e5x")]),
            ("1__0", &[(BadNumber, "1__0")]),
            ("1_", &[(BadNumber, "1_")]),
            ("1_.5", &[(BadNumber, "1_"), (Dot, "."), (Int, "5")]),
            ("1.5e", &[(BadNumber, "1.5e")]),
            ("1_.5_x", &[(BadNumber, "1_.5_x")]),
            ("1.2.3", &[(Real, "1.2"), (Dot, "."), (Int, "3")]),
        ] {
            let found: Vec<_> = found.iter().map(|&(kind, text)| (Some(kind), text)).collect();
            assert_eq!(scanned(text), found);
        }
    }

    #[test]
    fn the_longest_sign_is_taken() {
        use Kind::{
            Arrow, Assign, BothWays, Colon, Foreign, Less, LessOrEqual, LineComment, Link, OpenComment, Slash,
        };
        for (text, found) in [
            ("<->", &[BothWays][..]),
            ("<-->", &[Less, Link, Kind::Greater]),
            ("<=->", &[LessOrEqual, Arrow]),
            (":=: =", &[Assign, Colon, Kind::Equal]),
            ("/ /= /* // *)", &[Slash, Foreign, OpenComment, LineComment]),
            ("!!=&&", &[Foreign, Foreign, Foreign]),
        ] {
            assert_eq!(kinds(text), found.iter().map(|&kind| Some(kind)).collect::<Vec<_>>(), "{text}");
        }
        for sign in SIGNS {
            assert_eq!(scanned(sign.describe()), [(Some(sign), sign.describe())]);
        }
    }

    #[test]
    fn quotes_end_with_their_line_and_unknown_characters_are_single() {
        assert_eq!(scanned("\"ä\" \"b\n"), [(Some(Kind::Text), "\"ä\""), (Some(Kind::OpenText), "\"b")]);
        assert_eq!(scanned("'a' 'b"), [(Some(Kind::SingleQuotes), "'a'"), (Some(Kind::SingleQuotes), "'b")]);
        assert_eq!(scanned("& ä#"), [(None, "&"), (None, "ä"), (None, "#")]);
        assert_eq!(scanned(" \t\r\n\x0C"), []);
    }
}
