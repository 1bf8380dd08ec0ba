//! The formatter, `imrs fmt`: one way to write a cell file.
//!
//! Like gofmt, the formatter keeps line breaks and comments where they are. It decides everything else: indentation,
//! spaces, at most one empty line, lower-case keywords, one spelling of each option (D10). Trailing `//` comments of
//! consecutive lines that begin in one column still do so afterwards.

mod align;
mod layout;
mod space;

use crate::diagnostic::{Diagnostic, Severity};
use crate::lexer::{Kind, Token, lex};
use crate::names;
use crate::parser::parse;
use crate::report::Report;
use crate::source::Source;
use crate::words::Word;
use std::borrow::Cow;
use std::collections::HashSet;

/// The formatted text. Only a text without errors is formatted.
///
/// # Errors
/// The diagnostics, if one of them is an error.
pub fn format(source: &Source) -> Result<String, Vec<Diagnostic>> {
    let parsed = parse(source);
    if parsed.diagnostics.iter().any(|found| found.severity == Severity::Error) {
        return Err(parsed.diagnostics);
    }
    let mut names = HashSet::new();
    names::each(&parsed.file, &mut |name| {
        names.insert(name.span.start);
    });
    // Lexing reports no errors here, because the text was parsed before.
    let lexed = lex(source.text(), &mut Report::default());
    let mut writer = Writer { source, names: &names, pieces: Vec::new() };
    writer.all(&lexed.tokens, &lexed.comments);
    Ok(layout::lay_out(&writer.pieces))
}

/// The kind of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    /// A keyword that is not used as a name.
    Word(Word),
    /// A name, a number, a text.
    Operand,
    Sign(Kind),
    LineComment,
    BlockComment,
}

/// A token or a comment, as it will be written.
struct Piece<'t> {
    what: What,
    text: Cow<'t, str>,
    /// How many line breaks stand in front of the piece in the source.
    breaks: usize,
    /// The column of a comment in the source, from 1; 0 for a token.
    column: usize,
}

/// Merges the tokens and comments into pieces, and sets their spelling.
struct Writer<'t> {
    source: &'t Source,
    /// The offsets of the names: a keyword that is not reserved is a name if it stands at one of these offsets.
    names: &'t HashSet<u32>,
    pieces: Vec<Piece<'t>>,
}

impl<'t> Writer<'t> {
    fn all(&mut self, tokens: &[Token], comments: &[crate::Span]) {
        let mut comments = comments.iter().copied().peekable();
        let mut last = 0;
        let mut in_record = false;
        let mut users = Users::Outside;
        for (index, (kind, span)) in tokens.iter().enumerate() {
            while let Some(comment) = comments.next_if(|comment| comment.start < span.start) {
                self.comment(comment, &mut last);
            }
            let mut what = self.what(*kind, span.start);
            let follows = tokens.get(index + 1);
            let follows = follows.map(|(kind, span)| self.what(*kind, span.start));
            users = users.next(what);
            match (users, what) {
                (Users::Inside, What::Sign(Kind::ParenOpen)) => what = What::Sign(Kind::BraceOpen),
                (Users::Closing, What::Sign(Kind::ParenClose)) => what = What::Sign(Kind::BraceClose),
                (Users::Inside, What::Sign(Kind::Comma)) => {
                    // Commas are inserted below, between two names.
                    last = span.end as usize;
                    continue;
                }
                _ => {}
            }
            let breaks = self.breaks(last, span.start);
            last = span.end as usize;
            self.pieces.push(Piece { what, text: self.spelling(what, *span), breaks, column: 0 });
            let is_operand = what == What::Operand;
            if users == Users::Inside && is_operand && self.another_user(&tokens[index + 1..]) {
                self.insert(Kind::Comma);
            }
            in_record = match what {
                What::Word(Word::Record) => true,
                What::Word(Word::End) => {
                    if in_record && follows != Some(What::Sign(Kind::Semicolon)) {
                        self.insert(Kind::Semicolon);
                    }
                    false
                }
                _ => in_record,
            };
            if in_record && is_operand && matches!(follows, Some(What::Operand | What::Word(_))) {
                // Figure 1 writes `number integer`, without a colon.
                self.insert(Kind::Colon);
            }
        }
        for comment in comments {
            self.comment(comment, &mut last);
        }
    }

    /// Whether another name follows in the `user_list`.
    fn another_user(&self, rest: &[Token]) -> bool {
        let next = rest.iter().find(|(kind, _)| *kind != Kind::Comma);
        next.is_some_and(|(kind, span)| self.what(*kind, span.start) == What::Operand)
    }

    fn what(&self, kind: Kind, start: u32) -> What {
        match kind {
            Kind::Word(word) if word.is_reserved() || !self.names.contains(&start) => What::Word(word),
            Kind::Name | Kind::Word(_) | Kind::Int | Kind::Real | Kind::Text => What::Operand,
            sign => What::Sign(sign),
        }
    }

    fn spelling(&self, what: What, span: crate::Span) -> Cow<'t, str> {
        match what {
            What::Word(word) => Cow::Borrowed(word.text()),
            What::Sign(kind) => Cow::Borrowed(kind.describe()),
            What::Operand | What::LineComment | What::BlockComment => Cow::Borrowed(self.source.slice(span)),
        }
    }

    fn breaks(&self, from: usize, to: u32) -> usize {
        self.source.text()[from..to as usize].bytes().filter(|byte| *byte == b'\n').count()
    }

    fn comment(&mut self, span: crate::Span, last: &mut usize) {
        let text = self.source.slice(span);
        let breaks = self.breaks(*last, span.start);
        let what = if text.starts_with("//") { What::LineComment } else { What::BlockComment };
        let trimmed: Vec<&str> = text.split('\n').map(str::trim_end).collect();
        let (_, column) = self.source.position(span.start);
        self.pieces.push(Piece { what, text: Cow::Owned(trimmed.join("\n")), breaks, column });
        *last = span.end as usize;
    }

    fn insert(&mut self, kind: Kind) {
        let text = Cow::Borrowed(kind.describe());
        self.pieces.push(Piece { what: What::Sign(kind), text, breaks: 0, column: 0 });
    }
}

/// Where the current token stands in `user_list = (a b)`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Users {
    Outside,
    /// After the word `user_list`.
    Named,
    /// Inside of the list: from its opening bracket on.
    Inside,
    /// At the closing bracket of the list.
    Closing,
}

impl Users {
    fn next(self, what: What) -> Self {
        match (self, what) {
            (_, What::Word(Word::UserList)) => Self::Named,
            (Self::Named, What::Sign(Kind::Equal)) => Self::Named,
            (Self::Named, What::Sign(Kind::ParenOpen | Kind::BraceOpen)) => Self::Inside,
            (Self::Inside, What::Sign(Kind::ParenClose | Kind::BraceClose)) => Self::Closing,
            (Self::Inside, _) => Self::Inside,
            (Self::Outside | Self::Named | Self::Closing, _) => Self::Outside,
        }
    }
}
