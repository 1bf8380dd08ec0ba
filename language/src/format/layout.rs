//! Writes lines with their indentation.

use super::align::Aligner;
use super::space::Spacing;
use super::{Piece, What};
use crate::lexer::Kind;
use crate::words::Word;

/// How many spaces one level of indentation has.
const STEP: usize = 2;

/// The open blocks, each with the level of the line on which it began.
#[derive(Default)]
struct Blocks {
    open: Vec<(Word, usize)>,
    /// The previous token of the line.
    last: Option<What>,
    /// The level of the current line.
    level: usize,
    /// Whether the tokens are in the head of a task: the `on` there opens no block.
    in_head: bool,
}

/// Writes the pieces of a file, with their line breaks.
pub(super) fn lay_out(pieces: &[Piece<'_>]) -> String {
    let mut out = String::new();
    let mut blocks = Blocks::default();
    let mut spacing = Spacing::default();
    let mut aligner = Aligner::default();
    for (index, piece) in pieces.iter().enumerate() {
        let is_comment = matches!(piece.what, What::LineComment | What::BlockComment);
        // The piece behind a `//` comment must not become a part of the comment.
        let least = usize::from(index > 0 && pieces[index - 1].what == What::LineComment);
        let breaks = if out.is_empty() { 0 } else { piece.breaks.clamp(least, 2) };
        if breaks > 0 || out.is_empty() {
            let rest = pieces[index..].iter().map(|piece| piece.what);
            let next = rest.into_iter().find(|what| !matches!(what, What::LineComment | What::BlockComment));
            blocks.level = blocks.level_of(next, is_comment);
            out.extend(std::iter::repeat_n('\n', breaks));
            out.extend(std::iter::repeat_n(' ', blocks.level * STEP));
        } else if piece.what == What::LineComment {
            aligner.note(&out, piece.column);
        } else {
            out.extend(std::iter::repeat_n(' ', spacing.before(piece.what)));
        }
        out.push_str(&piece.text);
        spacing.note(piece.what);
        if !is_comment {
            blocks.note(piece.what);
        }
    }
    if !out.is_empty() {
        out.push('\n');
    }
    aligner.pad(&out)
}

impl Blocks {
    /// The level of a line that begins with `what`, or with a comment in front of it.
    fn level_of(&self, what: Option<What>, is_comment: bool) -> usize {
        let inside = self.open.last().map_or(0, |(_, level)| level + 1);
        let word = match what {
            Some(What::Word(word)) => Some(word),
            _ => None,
        };
        let closes = matches!(
            word,
            Some(
                Word::End
                    | Word::Else
                    | Word::Elsif
                    | Word::Begin
                    | Word::Takeover
                    | Word::Then
                    | Word::Do
                    | Word::Record
            )
        );
        // Outside of blocks the word `takeover` belongs to a `couple` and closes no block, and a `record` has the
        // indentation of its `type`.
        if closes && !self.open.is_empty() && !is_comment {
            return inside - 1;
        }
        if word == Some(Word::Record) && !is_comment {
            return inside;
        }
        inside + usize::from(self.is_amid(word))
    }

    /// Whether a statement or declaration has begun, but not ended.
    fn is_amid(&self, next: Option<Word>) -> bool {
        if self.in_head
            && matches!(next, Some(Word::Port | Word::UsePort | Word::Var | Word::Begin | Word::End))
        {
            return false;
        }
        match self.last {
            None | Some(What::Sign(Kind::Semicolon)) => false,
            Some(What::Word(word)) => !matches!(
                word,
                Word::Record
                    | Word::Begin
                    | Word::Takeover
                    | Word::Then
                    | Word::Do
                    | Word::Else
                    | Word::Loop
                    | Word::Atomic
            ),
            Some(_) => true,
        }
    }

    fn note(&mut self, what: What) {
        self.last = Some(what);
        let What::Word(word) = what else { return };
        match word {
            Word::Task => {
                self.in_head = true;
                self.open.push((word, self.level));
            }
            // The `on` in the head of a task opens no block.
            Word::Begin => self.in_head = false,
            Word::On if self.in_head => {}
            Word::Record | Word::If | Word::While | Word::Loop | Word::Atomic | Word::On => {
                self.open.push((word, self.level));
            }
            Word::End => {
                self.open.pop();
                self.in_head = false;
            }
            _ => {}
        }
    }
}
