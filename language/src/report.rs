//! Diagnostics on their way out: the first hundred in full, the others as a number.

use crate::codes::MORE;
use crate::diagnostic::Diagnostic;
use crate::span::Span;

/// So many are shown.
pub(crate) const SHOWN: usize = 100;
/// After so many nothing is looked for any more.
const COUNTED: usize = 1000;

/// What was found so far.
#[derive(Default)]
pub(crate) struct Report {
    shown: Vec<Diagnostic>,
    more: usize,
    stopped: bool,
}

impl Report {
    /// One more.
    pub(crate) fn push(&mut self, found: impl FnOnce() -> Diagnostic) {
        if self.shown.len() < SHOWN {
            self.shown.push(found());
        } else {
            self.more += 1;
        }
    }

    /// Whether there is so much that looking for more is of no use.
    pub(crate) fn is_enough(&mut self) -> bool {
        self.stopped |= self.shown.len() + self.more >= COUNTED;
        self.stopped
    }

    /// Whether there is more than is shown.
    pub(crate) fn is_more(&self) -> bool {
        self.more > 0
    }

    /// Where those that are shown stand, sorted.
    pub(crate) fn places(&self) -> Vec<u32> {
        let mut places: Vec<u32> = self.shown.iter().map(|found| found.primary.span.start).collect();
        places.sort_unstable();
        places
    }

    /// All of them, in the order of the text.
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
