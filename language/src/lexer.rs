//! The lexer: turns text into tokens. It keeps comments apart, for the formatter. It reports and skips characters that form
//! no token.

mod scanner;

use crate::codes::{NUMBER, OPERATOR, UNCLOSED_TEXT, UNKNOWN};
use crate::diagnostic::Diagnostic;
use crate::report::Report;
use crate::span::Span;
use crate::words::Word;
use scanner::Scanner;

/// The kind of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Kind {
    Name,
    /// A keyword of the language.
    Word(Word),
    Int,
    Real,
    /// Digits followed by letters, as in `12ab`.
    BadNumber,
    Text,
    OpenText,
    SingleQuotes,
    Semicolon,
    Colon,
    Comma,
    Dot,
    DotDot,
    Assign,
    Arrow,
    BothWays,
    Link,
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    Plus,
    Minus,
    Times,
    Slash,
    ParenOpen,
    ParenClose,
    BraceOpen,
    BraceClose,
    BracketOpen,
    BracketClose,
    /// An operator of another language.
    Foreign,
    LineComment,
    OpenComment,
}

impl Kind {
    /// How a diagnostic names the kind; the text of names and numbers is not part of it.
    pub(crate) const fn describe(self) -> &'static str {
        match self {
            Self::Name => "a name",
            Self::Word(word) => word.text(),
            Self::Int | Self::Real | Self::BadNumber => "a number",
            Self::Text | Self::OpenText | Self::SingleQuotes => "a text in quotes",
            Self::Semicolon => ";",
            Self::Colon => ":",
            Self::Comma => ",",
            Self::Dot => ".",
            Self::DotDot => "..",
            Self::Assign => ":=",
            Self::Arrow => "->",
            Self::BothWays => "<->",
            Self::Link => "--",
            Self::Equal => "=",
            Self::NotEqual => "<>",
            Self::Less => "<",
            Self::LessOrEqual => "<=",
            Self::Greater => ">",
            Self::GreaterOrEqual => ">=",
            Self::Plus => "+",
            Self::Minus => "-",
            Self::Times => "*",
            Self::Slash => "/",
            Self::ParenOpen => "(",
            Self::ParenClose => ")",
            Self::BraceOpen => "{",
            Self::BraceClose => "}",
            Self::BracketOpen => "[",
            Self::BracketClose => "]",
            Self::Foreign | Self::LineComment | Self::OpenComment => "a sign",
        }
    }

    /// Whether a token of this kind may be a name. Keywords that are not reserved may be names, too.
    pub(crate) const fn may_be_name(self) -> bool {
        match self {
            Self::Name => true,
            Self::Word(word) => !word.is_reserved(),
            _ => false,
        }
    }

    /// Whether [`describe`](Self::describe) returns the token's own text.
    pub(crate) const fn is_literal(self) -> bool {
        !matches!(
            self,
            Self::Name
                | Self::Int
                | Self::Real
                | Self::BadNumber
                | Self::Text
                | Self::OpenText
                | Self::SingleQuotes
                | Self::Foreign
                | Self::LineComment
                | Self::OpenComment
        )
    }
}

/// A token and its span.
pub(crate) type Token = (Kind, Span);

/// The result of lexing a text.
pub(crate) struct Lexed {
    /// The tokens of the file, in the order of the file.
    pub tokens: Vec<Token>,
    /// The spans of the comments, in order.
    pub comments: Vec<Span>,
    /// Whether the text ends inside of a comment. If so, any part of the file may be missing from the tokens.
    pub open_ended: bool,
}

/// The longest allowed name, in bytes.
pub(crate) const LONGEST_NAME: usize = 64;

/// Splits a text into tokens.
pub(crate) fn lex(text: &str, report: &mut Report) -> Lexed {
    let mut lexed = Lexed { tokens: Vec::new(), comments: Vec::new(), open_ended: false };
    let mut lexer = Scanner::new(text);
    let mut unknown: Option<Span> = None;
    while let Some(kind) = lexer.next_token() {
        let span = Span::new(lexer.span().start, lexer.span().end);
        let Some(kind) = kind else {
            match &mut unknown {
                Some(run) if run.end == span.start => run.end = span.end,
                _ => {
                    if let Some(run) = unknown.replace(span) {
                        report.push(|| not_known(text, run));
                    }
                }
            }
            continue;
        };
        match kind {
            Kind::LineComment => lexed.comments.push(span),
            Kind::OpenComment => {
                let (length, closed) = comment(&text[lexer.span().start..]);
                lexer.bump(length - 2);
                lexed.comments.push(Span::new(span.start as usize, span.start as usize + length));
                if !closed {
                    lexed.open_ended = true;
                    report.push(|| open_comment(span));
                }
            }
            Kind::BadNumber if let Some(digits) = before_unit(lexer.slice()) => {
                let (number, unit) = lexer.slice().split_at(digits);
                let kind = if number.contains('.') { Kind::Real } else { Kind::Int };
                let [start, middle, end] =
                    [span.start as usize, span.start as usize + digits, span.end as usize];
                lexed.tokens.push((kind, Span::new(start, middle)));
                let unit = Word::find(unit).or_else(|| Word::short_unit(unit));
                lexed.tokens.push((unit.map_or(Kind::Name, Kind::Word), Span::new(middle, end)));
            }
            Kind::Foreign
                if lexer.slice() == "!"
                    && lexed.tokens.last().is_none_or(|(last, _)| ends_statement(*last)) =>
            {
                let length = lexer.remainder().find('\n').unwrap_or(lexer.remainder().len());
                lexer.bump(length);
                report.push(|| {
                    Diagnostic::error(OPERATOR, span, "`!` begins no comment here").help("write `// ..`")
                });
            }
            // After a number the short units of the command line (`ms`) are accepted here, too.
            Kind::Name
                if let (Some((Kind::Int | Kind::Real, _)), Some(unit)) =
                    (lexed.tokens.last(), Word::short_unit(lexer.slice())) =>
            {
                lexed.tokens.push((Kind::Word(unit), span));
            }
            kind => lexed.tokens.push((token(kind, lexer.slice(), span, report), span)),
        }
    }
    if let Some(run) = unknown {
        report.push(|| not_known(text, run));
    }
    lexed
}

/// The length of the comment at the beginning of `text`, and whether the comment ends. Comments of one kind nest (IEC
/// 61131-3).
fn comment(text: &str) -> (usize, bool) {
    let bytes = text.as_bytes();
    let (open, close): (&[u8], &[u8]) =
        if bytes.starts_with(b"(*") { (b"(*", b"*)") } else { (b"/*", b"*/") };
    let (mut at, mut depth) = (2, 1_usize);
    while let Some(pair) = bytes.get(at..at + 2) {
        if pair == close {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return (at, true);
            }
        } else if pair == open {
            depth += 1;
            at += 2;
        } else {
            at += 1;
        }
    }
    (bytes.len(), false)
}

/// Whether a statement or a declaration, but no condition, may begin right after this token.
const fn ends_statement(token: Kind) -> bool {
    use Word::{Begin, Do, Else, Is, Loop, Record, Takeover, Then};
    matches!(token, Kind::Semicolon | Kind::Word(Begin | Do | Then | Else | Loop | Is | Record | Takeover))
}

/// The kind under which the parser sees this token. Reports a token that is wrong.
fn token(kind: Kind, text: &str, span: Span, report: &mut Report) -> Kind {
    match kind {
        Kind::Name => {
            if text.len() > LONGEST_NAME {
                report.push(|| long_name(text, span));
            }
            Word::find(text).map_or(Kind::Name, Kind::Word)
        }
        Kind::BadNumber => {
            report.push(|| bad_number(text, span));
            Kind::Int
        }
        Kind::OpenText => {
            report.push(|| {
                Diagnostic::error(UNCLOSED_TEXT, span, "this text is not closed")
                    .label("no `\"` until the end of the line")
                    .help("a text stands between two `\"` on one line")
            });
            Kind::Text
        }
        Kind::SingleQuotes => {
            report.push(|| {
                Diagnostic::error(UNKNOWN, span, "a text stands in double quotes")
                    .help(format!("write `\"{}\"`", text.trim_matches('\'')))
            });
            Kind::Text
        }
        Kind::Foreign if matches!(text, "+=" | "-=" | "*=") => {
            let sign = &text[..1];
            report.push(|| {
                Diagnostic::error(OPERATOR, span, format!("`{text}` is not an assignment here"))
                    .help(format!("write `n := n {sign} ..`"))
            });
            Kind::Assign
        }
        Kind::Foreign => {
            let (ours, kind) = match text {
                "==" => ("=", Kind::Equal),
                // `/=` means "not equal" in Ada, and an assignment in other languages.
                "/=" => ("<>", Kind::NotEqual),
                "!=" => ("<>", Kind::NotEqual),
                "&&" => ("and", Kind::Word(Word::And)),
                "||" => ("or", Kind::Word(Word::Or)),
                "!" => ("not", Kind::Word(Word::Not)),
                _ => ("mod", Kind::Word(Word::Mod)),
            };
            report.push(|| {
                Diagnostic::error(OPERATOR, span, format!("`{text}` is written `{ours}` here"))
                    .help(format!("write `{ours}`"))
            });
            kind
        }
        other => other,
    }
}

fn not_known(text: &str, span: Span) -> Diagnostic {
    let run = &text[span.range()];
    let first = run.chars().next().unwrap_or_default();
    let message = if run.chars().nth(1).is_some() {
        let shown: String = run.chars().take(12).flat_map(char::escape_debug).collect();
        let dots = if run.chars().nth(12).is_some() { "..." } else { "" };
        format!("these characters are not known: `{shown}{dots}`")
    } else {
        format!("this character is not known: `{}`", first.escape_debug())
    };
    let found = Diagnostic::error(UNKNOWN, span, message);
    if first.is_alphabetic() {
        return found.help("names are made of the letters a to z, digits and `_`");
    }
    let follows = text[..span.range().start].ends_with(|c: char| c.is_ascii_alphanumeric());
    found.help(match first {
        '#' if follows => "a time is written `5 sec` or `200 msec`, and a number in decimals",
        '#' => "a comment begins with `//`; a cell is one file, and includes no other",
        '$' => "signals of a robot belong to its driver: `run NAME;` sets an output, `run NAME -> x;` reads an input",
        '?' => "choices are written `if ... then ... else ... end;`",
        '^' => "there is no power: write the factors, `x * x`",
        _ => "outside of comments and texts the language uses plain ASCII",
    })
}

fn open_comment(span: Span) -> Diagnostic {
    Diagnostic::error(UNCLOSED_TEXT, span, "this comment is not closed")
        .label("everything from here on is comment")
        .help("comments may hold comments of their own kind: each `(*` wants its `*)`, each `/*` its `*/`")
}

fn long_name(text: &str, span: Span) -> Diagnostic {
    let message = format!("this name has {} bytes; at most {LONGEST_NAME} are allowed", text.len());
    Diagnostic::error(crate::codes::LIMIT, span, message).help("choose a shorter name")
}

/// The length of a number that is followed by a unit of time without a space, as in `500ms`.
fn before_unit(text: &str) -> Option<usize> {
    let end = text.find(|c: char| c.is_ascii_alphabetic())?;
    let (number, unit) = text.split_at(end);
    let known = |(word, _): &(Word, u64)| word.text().eq_ignore_ascii_case(unit);
    let is_unit = Word::UNITS.iter().any(known) || Word::short_unit(unit).is_some();
    let split = number.ends_with('_') || number.contains("__") || number.contains("_.");
    (is_unit && !split).then_some(end)
}

fn bad_number(text: &str, span: Span) -> Diagnostic {
    let shown: String = text.chars().take(24).collect();
    Diagnostic::error(NUMBER, span, format!("`{shown}` is neither a number nor a name"))
        .help("a number is written `12`, `1_000`, `0.5` or `1.5e3`; a name begins with a letter")
}
