//! Limits of depth and length, checked before parsing: no recursion over an accepted tree can overflow the stack.

use crate::codes::LIMIT;
use crate::diagnostic::Diagnostic;
use crate::lexer::{Kind, Token};
use crate::words::Word;

/// How deep blocks, parentheses, and signs in front of operands may be nested.
pub(crate) const DEEPEST: usize = 64;
/// How many operators and parentheses an expression may have.
pub(crate) const LONGEST_EXPRESSION: usize = 256;

/// The diagnostic for the first place that exceeds a limit.
pub(super) fn exceeded(tokens: &[Token]) -> Option<Diagnostic> {
    let (mut blocks, mut brackets, mut signs, mut operators) = (0_usize, 0_usize, 0_usize, 0_usize);
    for (kind, span) in tokens {
        let is_sign = matches!(kind, Kind::Minus | Kind::Word(Word::Not));
        signs = if is_sign { signs + 1 } else { 0 };
        match kind {
            Kind::Word(Word::Begin | Word::If | Word::Loop | Word::Atomic | Word::Do) => blocks += 1,
            Kind::Word(Word::End) => blocks = blocks.saturating_sub(1),
            Kind::ParenOpen | Kind::BraceOpen | Kind::BracketOpen => brackets += 1,
            Kind::ParenClose | Kind::BraceClose | Kind::BracketClose => brackets = brackets.saturating_sub(1),
            _ => {}
        }
        if is_operator(*kind) {
            operators += 1;
        } else if ends_expression(*kind) {
            (operators, brackets) = (0, if *kind == Kind::Comma { brackets } else { 0 });
        }
        let message = if blocks > DEEPEST {
            format!("more than {DEEPEST} blocks are nested here")
        } else if brackets > DEEPEST || signs > DEEPEST {
            format!("more than {DEEPEST} parentheses or signs are nested here")
        } else if operators > LONGEST_EXPRESSION {
            format!("this expression has more than {LONGEST_EXPRESSION} operators and parentheses")
        } else {
            continue;
        };
        return Some(Diagnostic::error(LIMIT, *span, message).help("split it"));
    }
    None
}

fn is_operator(kind: Kind) -> bool {
    matches!(
        kind,
        Kind::Plus
            | Kind::Minus
            | Kind::Times
            | Kind::Slash
            | Kind::Equal
            | Kind::NotEqual
            | Kind::Less
            | Kind::LessOrEqual
            | Kind::Greater
            | Kind::GreaterOrEqual
            | Kind::ParenOpen
            | Kind::Word(Word::And | Word::Or | Word::Not | Word::Mod)
    )
}

fn ends_expression(kind: Kind) -> bool {
    match kind {
        Kind::Semicolon | Kind::Comma | Kind::Assign | Kind::Arrow | Kind::DotDot => true,
        Kind::Word(word) => word.is_reserved() && !matches!(word, Word::True | Word::False),
        _ => false,
    }
}
