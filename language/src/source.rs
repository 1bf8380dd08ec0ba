//! The text of a cell file.

use crate::codes::{LIMIT, NOT_TEXT};
use crate::diagnostic::Diagnostic;
use crate::span::Span;

/// The longest file, in bytes.
pub const LONGEST_FILE: usize = 16 << 20;

/// The text of a file, with the offsets of its lines. Spans count the bytes of this text, without a byte order mark.
#[derive(Clone, Debug)]
pub struct Source {
    text: String,
    lines: Vec<u32>,
}

impl Source {
    /// Reads UTF-8 text, with or without a byte order mark. The lines of the text end with LF or CR LF.
    ///
    /// # Errors
    /// E013 if the bytes are not UTF-8, E012 if the file is longer than 16 MiB.
    pub fn new(bytes: &[u8]) -> Result<Self, Box<Diagnostic>> {
        if bytes.len() > LONGEST_FILE {
            let message = format!("the file has {} bytes; at most {LONGEST_FILE} are read", bytes.len());
            let found =
                Diagnostic::error(LIMIT, Span::default(), message).help("split it: is it a cell file?");
            return Err(Box::new(found));
        }
        let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes);
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(Self::of_text(text)),
            Err(error) => {
                let at = error.valid_up_to();
                let byte = bytes.get(at).copied().unwrap_or_default();
                let line = bytes[..at].iter().filter(|b| **b == b'\n').count() + 1;
                let message = format!("byte {at} (line {line}) is 0x{byte:02X}: the file is not UTF-8 text");
                let found = Diagnostic::error(NOT_TEXT, Span::new(at, at + 1), message);
                Err(Box::new(found.help("save the file as UTF-8")))
            }
        }
    }

    fn of_text(text: &str) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        let lines = std::iter::once(0).chain(ends.map(|(at, _)| u32::try_from(at + 1).unwrap_or(u32::MAX)));
        Self { text: text.to_owned(), lines: lines.collect() }
    }

    /// The text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The text of a span; empty if the span is not in this text.
    #[must_use]
    pub fn slice(&self, span: Span) -> &str {
        self.text.get(span.range()).unwrap_or_default()
    }

    /// The line and the column of a byte, both from 1; columns count characters.
    #[must_use]
    pub fn position(&self, byte: u32) -> (usize, usize) {
        let line = self.lines.partition_point(|begin| *begin <= byte).max(1);
        let begin = self.lines[line - 1] as usize;
        let end = (byte as usize).min(self.text.len());
        let before = self.text.as_bytes().get(begin..end).unwrap_or_default();
        // Continuation bytes of UTF-8 are part of the character before.
        let column = before.iter().filter(|byte| **byte & 0xC0 != 0x80).count();
        (line, column + 1)
    }

    /// The line of a byte, from 1.
    #[must_use]
    pub(crate) fn line(&self, byte: u32) -> usize {
        self.lines.partition_point(|begin| *begin <= byte).max(1)
    }

    /// How many blanks begin the line of a byte, and whether that byte is the first one behind the blanks.
    #[must_use]
    pub(crate) fn indentation(&self, byte: u32) -> (usize, bool) {
        let begin = self.lines[self.line(byte) - 1] as usize;
        let rest = self.text.get(begin..).unwrap_or_default();
        let blanks = rest.len() - rest.trim_start_matches([' ', '\t']).len();
        (blanks, begin + blanks == byte as usize)
    }
}
