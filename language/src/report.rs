//! Collects diagnostics: keeps the first hundred, and counts the others.

use crate::codes::MORE;
use crate::diagnostic::Diagnostic;
use crate::span::Span;

/// The greatest number of diagnostics that are kept and shown.
pub(crate) const SHOWN: usize = 100;
/// After this many diagnostics the compiler stops looking for more.
const COUNTED: usize = 1000;

/// The diagnostics that were found so far.
#[derive(Default)]
pub(crate) struct Report {
    shown: Vec<Diagnostic>,
    more: usize,
    stopped: bool,
}

impl Report {
    /// Adds a diagnostic, which `found` makes if it will be shown.
    pub(crate) fn push(&mut self, found: impl FnOnce() -> Diagnostic) {
        if self.shown.len() < SHOWN {
            self.shown.push(found());
        } else {
            self.more += 1;
        }
    }

    /// Whether there are so many diagnostics that the search should stop.
    pub(crate) fn is_enough(&mut self) -> bool {
        self.stopped |= self.shown.len() + self.more >= COUNTED;
        self.stopped
    }

    /// Whether there are more diagnostics than are shown.
    pub(crate) fn is_more(&self) -> bool {
        self.more > 0
    }

    /// The offsets of the shown diagnostics, sorted.
    pub(crate) fn places(&self) -> Vec<u32> {
        let mut places: Vec<u32> = self.shown.iter().map(|found| found.primary.span.start).collect();
        places.sort_unstable();
        places
    }

    /// The shown diagnostics in the order of the text, and a note that counts the others.
    pub(crate) fn finish(mut self) -> Vec<Diagnostic> {
        self.shown.sort_by_key(|found| found.primary.span.start);
        if self.more > 0 {
            let last = self.shown.last().map_or(Span::default(), |found| found.primary.span);
            let some = if self.stopped { "at least " } else { "" };
            let words = if self.more == 1 { "error is" } else { "errors are" };
            let message = format!("{some}{} more {words} not shown", self.more);
            self.shown.push(Diagnostic::note(MORE, last, message));
        }
        self.shown
    }
}
