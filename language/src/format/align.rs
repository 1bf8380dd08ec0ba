//! Aligns trailing `//` comments.

/// How many spaces stand between the longest line of a group and its comment.
const GAP: usize = 2;

/// A `//` comment behind code.
struct Trailing {
    /// Where the comment's text begins in the output, before the spaces in front of it are inserted.
    at: usize,
    /// The comment's line in the output.
    line: usize,
    /// How many characters the comment's line has in front of the comment.
    width: usize,
    /// The comment's column in the source.
    column: usize,
}

/// Collects the trailing comments while the lines are written, and then aligns them with spaces.
///
/// Comments of consecutive lines that began in the same column of the source are one group: they begin in the same
/// column of the output. A comment that began in another column is a group of its own, even if it then happens to stand
/// below the comments of the group.
#[derive(Default)]
pub(super) struct Aligner {
    comments: Vec<Trailing>,
    /// The number of bytes of the output in which line breaks were counted, and the number of line breaks
    /// found in them.
    counted: (usize, usize),
}

impl Aligner {
    /// Records that a trailing comment will follow this output.
    pub(super) fn note(&mut self, out: &str, column: usize) {
        let (from, lines) = self.counted;
        let line = lines + out[from..].matches('\n').count();
        self.counted = (out.len(), line);
        let begin = out.rfind('\n').map_or(0, |at| at + 1);
        let width = out[begin..].chars().count();
        self.comments.push(Trailing { at: out.len(), line, width, column });
    }

    /// The output with the spaces in front of the recorded comments.
    pub(super) fn pad(&self, out: &str) -> String {
        let mut padded = String::with_capacity(out.len() + self.comments.len() * GAP);
        let mut from = 0;
        for group in self.comments.chunk_by(|a, b| b.line == a.line + 1 && b.column == a.column) {
            let widest = group.iter().map(|comment| comment.width).max().unwrap_or_default();
            for comment in group {
                padded.push_str(&out[from..comment.at]);
                padded.extend(std::iter::repeat_n(' ', widest + GAP - comment.width));
                from = comment.at;
            }
        }
        padded.push_str(&out[from..]);
        padded
    }
}
