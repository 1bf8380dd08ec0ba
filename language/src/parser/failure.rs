//! What the grammar could not parse, and the diagnostics for it.

use super::Tokens;
use crate::codes::{MISSPELT, OPERATOR, RESERVED, SEMICOLON, UNEXPECTED};
use crate::diagnostic::Diagnostic;
use crate::foreign;
use crate::lexer::Kind;
use crate::span::Span;
use crate::words::Word;
use chumsky::DefaultExpected;
use chumsky::error::{Error, LabelError};
use chumsky::util::MaybeRef;

/// An alternative that the grammar would have accepted at some token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expected {
    Token(Kind),
    /// A part of the grammar, in words.
    Label(&'static str),
    /// The end of the part of a line that is being parsed.
    End,
}

/// Why a part of a line was not accepted.
#[derive(Clone, Debug)]
pub(super) enum Failure {
    Unexpected {
        span: Span,
        expected: Vec<Expected>,
    },
    /// The grammar parsed the part and found a fault in it.
    Said(Box<Diagnostic>),
}

/// The label under which the grammar expects a name. Diagnostics treat it specially.
pub(super) const NAME: &str = "a name";
/// The label under which the grammar expects a type. Diagnostics treat it specially.
pub(super) const TYPE: &str = "a type";
/// The label under which the grammar expects an expression. Diagnostics treat it specially.
pub(super) const EXPRESSION: &str = "an expression";
/// The label under which the grammar expects an option. Diagnostics treat it specially.
pub(super) const OPTION: &str = "an option";
/// The label under which the grammar expects a usage. Diagnostics treat it specially.
pub(super) const USAGE: &str = "a usage (`send`, `receive`, `reply`, `query`, `response`, `waitfor`)";
/// The label under which the grammar expects a fault. Diagnostics treat it specially.
pub(super) const FAULT: &str = "a fault (`loss`, `dup`, `fail`, `drift`, `crash`, `pause`, `cut`)";

impl<'t> Error<'t, Tokens<'t>> for Failure {
    fn merge(self, other: Self) -> Self {
        match (self, other) {
            (Self::Unexpected { span, mut expected }, Self::Unexpected { expected: others, .. }) => {
                for one in others {
                    if !expected.contains(&one) {
                        expected.push(one);
                    }
                }
                Self::Unexpected { span, expected }
            }
            (Self::Unexpected { .. }, said) => said,
            (said @ Self::Said(_), _) => said,
        }
    }
}

impl<'t> LabelError<'t, Tokens<'t>, DefaultExpected<'t, Kind>> for Failure {
    fn expected_found<E: IntoIterator<Item = DefaultExpected<'t, Kind>>>(
        expected: E,
        _found: Option<MaybeRef<'t, Kind>>,
        span: Span,
    ) -> Self {
        let plain = |one: DefaultExpected<'t, Kind>| match one {
            DefaultExpected::Token(kind) => Some(Expected::Token(kind.into_inner())),
            DefaultExpected::EndOfInput => Some(Expected::End),
            _ => None,
        };
        Self::Unexpected { span, expected: expected.into_iter().filter_map(plain).collect() }
    }
}

impl<'t> LabelError<'t, Tokens<'t>, &'static str> for Failure {
    fn expected_found<E: IntoIterator<Item = &'static str>>(
        expected: E,
        _found: Option<MaybeRef<'t, Kind>>,
        span: Span,
    ) -> Self {
        Self::Unexpected { span, expected: expected.into_iter().map(Expected::Label).collect() }
    }

    fn label_with(&mut self, label: &'static str) {
        if let Self::Unexpected { expected, .. } = self {
            expected.clear();
            expected.push(Expected::Label(label));
        }
    }
}

/// The token at which the grammar stopped.
pub(super) struct Found<'t> {
    /// The token's kind; `None` at the end of the file.
    pub kind: Option<Kind>,
    /// The token's text.
    pub text: &'t str,
    /// The token's span.
    pub span: Span,
    /// The span of the token before this one.
    pub after: Span,
    /// Whether the token is the first of its line.
    pub first_of_line: bool,
}

impl Found<'_> {
    /// How a diagnostic names the token.
    pub(super) fn describe(&self) -> String {
        match self.kind {
            None => "the end of the file".to_owned(),
            Some(Kind::Text) => "a text".to_owned(),
            Some(Kind::Name | Kind::Int | Kind::Real) => format!("`{}`", clip(self.text)),
            Some(Kind::Word(_)) => format!("`{}`", self.text),
            Some(kind) => format!("`{}`", kind.describe()),
        }
    }
}

/// Shortens a text for a diagnostic.
pub(super) fn clip(text: &str) -> String {
    if text.chars().count() <= 40 {
        return text.to_owned();
    }
    text.chars().take(37).chain("...".chars()).collect()
}

/// The diagnostic for an unexpected token. `end` is the token that should have ended the parsed part, such as `;` or
/// `then`.
pub(super) fn unexpected(expected: &[Expected], found: &Found<'_>, end: &str) -> Diagnostic {
    if found.kind == Some(Kind::Equal) && expected.contains(&Expected::Token(Kind::Assign)) {
        return Diagnostic::error(OPERATOR, found.span, "a value is assigned by `:=`").help("write `:=`");
    }
    let can_end = expected.contains(&Expected::End);
    let starts_anew = found.first_of_line || matches!(found.kind, None | Some(Kind::Word(_)));
    if can_end && end == ";" && starts_anew && near_option(expected, found).is_none() {
        return missing_semicolon(found);
    }
    if let Some(word) = near_option(expected, found) {
        return misspelt(found.span, found.text, word);
    }
    if let Some(Kind::Word(word)) = found.kind
        && word.is_reserved()
        && wants_name(expected)
        && !found.first_of_line
    {
        return reserved(found.span, found.text);
    }
    if let Some(foreign) = foreign_line(expected, found, end) {
        return foreign;
    }
    let wanted = in_words(expected, end);
    let what = found.describe();
    if wanted.is_empty() {
        return Diagnostic::error(UNEXPECTED, found.span, format!("{what} does not belong here"))
            .help("remove it");
    }
    let diagnostic = Diagnostic::error(UNEXPECTED, found.span, format!("expected {wanted}, found {what}"));
    let help = if let Some(help) = foreign_sign(expected, found, end) {
        help.to_owned()
    } else if can_end && !starts_anew {
        "write `;` here, or remove what follows".replace("`;`", &format!("`{end}`"))
    } else {
        format!("write {wanted} here")
    };
    diagnostic.label(format!("expected {wanted}")).help(help)
}

/// The diagnostic for a line of another language in the head of a task, or for a type of another language after `is`.
fn foreign_line(expected: &[Expected], found: &Found<'_>, end: &str) -> Option<Diagnostic> {
    let wants_record = expected.contains(&Expected::Token(Kind::Word(Word::Record)));
    let (wanted, help) = match found.kind {
        Some(kind)
            if found.first_of_line
                && end == "begin"
                && (kind == Kind::Name || foreign::is_type(found.text)) =>
        {
            ("`port`, `use_port`, `var` or `begin`", foreign::in_task(found.text))
        }
        Some(Kind::Name) if wants_record && foreign::is_known(found.text) => {
            ("`record`", foreign::declaration(found.text))
        }
        _ => return None,
    };
    let message = format!("expected {wanted}, found {}", found.describe());
    Some(Diagnostic::error(UNEXPECTED, found.span, message).help(help))
}

/// What to write in place of a sign of another language that the grammar did not expect.
fn foreign_sign(expected: &[Expected], found: &Found<'_>, end: &str) -> Option<&'static str> {
    let wants = |kind: Kind| expected.contains(&Expected::Token(kind));
    match (found.kind?, end) {
        (Kind::BracketOpen, _) => Some(foreign::NO_ARRAYS),
        (Kind::BraceOpen, "then") => Some("write `then`, and `end;` in place of `}`"),
        (Kind::BraceOpen, "do") => Some("write `do`, and `end;` in place of `}`"),
        (Kind::Equal | Kind::Assign, ";") => Some(
            "an assignment is a statement behind `begin`: `x := 1;`; a variable is zero or `false` at first",
        ),
        (Kind::Name, _) if wants(Kind::Colon) => Some(foreign::TYPE_BEHIND),
        (Kind::Name, _) => foreign::operator(found.text),
        (Kind::Text, _) if expected.contains(&Expected::Label(EXPRESSION)) => Some(foreign::NO_TEXTS),
        (Kind::Comma, _) if wants(Kind::ParenClose) => {
            Some("a function of several values is an action: `run NAME x, y -> z;`, and a driver computes it")
        }
        (Kind::ParenOpen, _) if wants(Kind::Assign) => {
            Some("there are no methods: an action outside is carried out by `run NAME x;`")
        }
        _ => None,
    }
}

/// Whether the grammar would have accepted a name.
pub(super) fn wants_name(expected: &[Expected]) -> bool {
    expected.iter().any(|one| matches!(one, Expected::Label(NAME | TYPE)))
}

/// The diagnostic for a missing semicolon behind the previous token.
pub(super) fn missing_semicolon(found: &Found<'_>) -> Diagnostic {
    let at = Span { start: found.after.end.saturating_sub(1).max(found.after.start), end: found.after.end };
    Diagnostic::error(SEMICOLON, at, format!("expected `;`, found {}", found.describe()))
        .label("a `;` is missing behind this")
        .help("write `;` behind it")
}

/// The diagnostic for a misspelt keyword.
pub(super) fn misspelt(span: Span, text: &str, word: Word) -> Diagnostic {
    Diagnostic::error(MISSPELT, span, format!("`{}` is not known here", clip(text)))
        .help(format!("did you mean `{}`?", word.text()))
}

/// The diagnostic for a reserved keyword in place of a name.
pub(super) fn reserved(span: Span, text: &str) -> Diagnostic {
    let message = format!("`{text}` is a keyword: choose another name");
    let found = Diagnostic::error(RESERVED, span, message).label("a name is expected here");
    if foreign::is_type(text) {
        return found.help(foreign::TYPE_BEHIND);
    }
    found.help(format!("write another name, such as `{text}_1`"))
}

/// The option or other keyword that was probably meant.
fn near_option(expected: &[Expected], found: &Found<'_>) -> Option<Word> {
    if found.kind != Some(Kind::Name) {
        return None;
    }
    let mut words: Vec<Word> = Vec::new();
    for one in expected {
        match one {
            Expected::Token(Kind::Word(word)) => words.push(*word),
            Expected::Label(OPTION) => words.extend(Word::OPTIONS),
            Expected::Label(USAGE) => words.extend([
                Word::Send,
                Word::Receive,
                Word::Reply,
                Word::Query,
                Word::Response,
                Word::Waitfor,
            ]),
            Expected::Label(FAULT) => {
                words.extend([Word::Loss, Word::Dup, Word::Fail, Word::Drift]);
                words.extend([Word::Crash, Word::Pause, Word::Cut]);
            }
            Expected::Token(_) | Expected::Label(_) | Expected::End => {}
        }
    }
    Word::near(found.text, &words)
}

/// The greatest number of alternatives that a diagnostic names.
const ALTERNATIVES: usize = 4;

fn in_words(expected: &[Expected], end: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut sorted = expected.to_vec();
    // The end of the line is the likeliest alternative, then parts of the grammar, then single tokens.
    sorted.sort_by_key(|one| match one {
        Expected::End => 0,
        Expected::Label(_) => 1,
        Expected::Token(_) => 2,
    });
    for one in sorted {
        let word = match one {
            Expected::End => format!("`{end}`"),
            Expected::Label(label) => label.to_owned(),
            Expected::Token(kind) if kind.is_literal() => format!("`{}`", kind.describe()),
            Expected::Token(kind) => kind.describe().to_owned(),
        };
        if !words.contains(&word) {
            words.push(word);
        }
    }
    words.truncate(ALTERNATIVES);
    match words.split_last() {
        None => String::new(),
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
    }
}
