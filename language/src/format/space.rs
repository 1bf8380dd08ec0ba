//! Sets the spaces between the tokens of a line.

use super::What;
use crate::lexer::Kind;
use crate::words::Word;

/// What the tokens written so far imply for the space before the next one.
#[derive(Default)]
pub(super) struct Spacing {
    last: Option<What>,
    /// Whether the last token is a unary minus.
    is_unary: bool,
    /// How many tokens of `rate = 20 /` were written.
    rate: u8,
    is_comment: bool,
}

impl Spacing {
    /// How many spaces stand in front of this piece.
    pub(super) fn before(&self, next: What) -> usize {
        let Some(last) = self.last else { return usize::from(self.is_comment) };
        match next {
            What::BlockComment => return 1,
            What::Sign(
                Kind::Semicolon
                | Kind::Comma
                | Kind::Colon
                | Kind::Dot
                | Kind::DotDot
                | Kind::ParenClose
                | Kind::BraceClose
                | Kind::BracketClose,
            ) => return 0,
            // The aligner sets the spaces in front of a trailing `//` comment.
            What::Word(_) | What::Operand | What::Sign(_) | What::LineComment => {}
        }
        if self.is_comment {
            return 1;
        }
        let glued = match (last, next) {
            (
                What::Sign(Kind::ParenOpen | Kind::BraceOpen | Kind::BracketOpen | Kind::Dot | Kind::DotDot),
                _,
            ) => true,
            // In `- -x` the two signs would form a `--` without the space.
            (What::Sign(Kind::Minus), What::Sign(Kind::Minus)) => false,
            (What::Sign(Kind::Minus), _) if self.is_unary => true,
            (What::Operand, What::Sign(Kind::ParenOpen)) => true,
            (What::Word(Word::Reply | Word::Response | Word::Trunc), What::Sign(Kind::ParenOpen)) => true,
            (_, What::Sign(Kind::BracketOpen)) => true,
            (_, What::Sign(Kind::Slash)) => self.rate == 3,
            (What::Sign(Kind::Slash), _) => self.rate == 4,
            _ => false,
        };
        usize::from(!glued)
    }

    /// Records a piece that was written.
    pub(super) fn note(&mut self, what: What) {
        self.is_comment = matches!(what, What::LineComment | What::BlockComment);
        if self.is_comment {
            return;
        }
        let operand_in_front = matches!(
            self.last,
            Some(What::Operand | What::Sign(Kind::ParenClose) | What::Word(Word::True | Word::False))
        );
        self.is_unary = what == What::Sign(Kind::Minus) && !operand_in_front;
        self.rate = match (self.rate, what) {
            (_, What::Word(Word::Rate | Word::Capacity)) => 1,
            (1, What::Sign(Kind::Equal)) => 2,
            (2, What::Operand) => 3,
            (3, What::Sign(Kind::Slash)) => 4,
            _ => 0,
        };
        self.last = Some(what);
    }
}
