//! The parser: turns tokens into a syntax tree.
//!
//! The driver finds blocks by their keywords (`loop`, `if`, `end`). A grammar of combinators parses the lines, one at a time.
//! So an error of any kind ends with its line, and the block around it stays intact.

mod blocks;
mod expr;
mod failure;
mod items;
mod limits;
mod lines;
mod mend;
mod statements;

use crate::ast::File;
use crate::diagnostic::Diagnostic;
use crate::lexer::{Kind, Token, lex};
use crate::lost::Lost;
use crate::report::Report;
use crate::source::Source;
use crate::span::Span;
use crate::words::Word;
use chumsky::input::MappedInput;
use chumsky::prelude::*;
use failure::{Failure, Found};
use lines::{Line, Lines};
use statements::Statements;

/// The tokens as input of the grammar.
type Tokens<'t> = MappedInput<'t, Kind, Span, &'t [Token]>;
type Extra = extra::Err<Failure>;

impl chumsky::span::Span for Span {
    type Context = ();
    type Offset = u32;

    fn new((): (), range: std::ops::Range<u32>) -> Self {
        Self { start: range.start, end: range.end }
    }

    fn context(&self) {}

    fn start(&self) -> u32 {
        self.start
    }

    fn end(&self) -> u32 {
        self.end
    }
}

/// A parsed file: its syntax tree and the diagnostics.
#[derive(Clone, Debug)]
pub struct Parsed {
    /// The syntax tree. It is complete if no diagnostic is an error.
    pub file: File,
    /// At most 100 diagnostics in the order of the text, and a note that counts the others.
    pub diagnostics: Vec<Diagnostic>,
    /// The parts that could not be parsed.
    pub(crate) lost: Lost,
}

/// Parses a cell file.
#[must_use]
pub fn parse(source: &Source) -> Parsed {
    let mut report = Report::default();
    let mut lexed = lex(source.text(), &mut report);
    if report.is_enough() {
        return nothing(report);
    }
    mend::mend(&mut lexed.tokens, source, &mut report);
    if let Some(found) = limits::exceeded(&lexed.tokens) {
        report.push(|| found);
        return nothing(report);
    }
    let faulty = report.places();
    let mut driver = Driver {
        source,
        tokens: &lexed.tokens,
        at: 0,
        report,
        lines: Lines::new(source.text()),
        statements: Statements::new(source.text()),
        faulty,
        open: Vec::new(),
        suspects: Vec::new(),
        open_ended: lexed.open_ended,
        left_open: None,
        broken: usize::MAX,
        lost: Lost::default(),
    };
    let file = driver.file();
    driver.lost.all = lexed.open_ended || driver.report.is_more();
    Parsed { file, diagnostics: driver.report.finish(), lost: driver.lost }
}

/// The result if the parser could not parse anything.
fn nothing(report: Report) -> Parsed {
    let lost = Lost { all: true, ..Lost::default() };
    Parsed { file: File::default(), diagnostics: report.finish(), lost }
}

/// The kind of line that is parsed: it decides which words end the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Context {
    /// A declaration at the top level of the file.
    Top,
    /// A field of a record.
    Field,
    /// A declaration of a task, in front of `begin`.
    Head,
    /// A statement is expected.
    Body,
}

/// An open block: its keyword, and the span of this keyword.
#[derive(Clone, Copy, Debug)]
struct Opener {
    word: Word,
    span: Span,
}

/// Finds the blocks and has the grammar parse the lines.
struct Driver<'t> {
    source: &'t Source,
    tokens: &'t [Token],
    /// The position of the next token to be parsed.
    at: usize,
    report: Report,
    lines: Lines<'t>,
    statements: Statements<'t>,
    /// The offsets of earlier diagnostics: a line that contains one of them is not reported again.
    faulty: Vec<u32>,
    /// The open blocks of the task, outermost first.
    open: Vec<Opener>,
    /// Blocks whose `end` is indented differently, with the span of that `end`.
    suspects: Vec<(Opener, Span)>,
    /// Whether the text ends inside of a comment. If so, any part of the file may be missing.
    open_ended: bool,
    /// The token at which the parser reported an unclosed block: it reports no missing `;` at this token.
    left_open: Option<usize>,
    /// The token behind a statement that could not be parsed: branches of that statement may follow here.
    broken: usize,
    /// The parts that could not be parsed.
    lost: Lost,
}

/// The result of parsing a line.
struct Read<O> {
    output: Option<O>,
    /// Where the grammar stopped, unless it accepted the line.
    stopped: Option<Stopped>,
}

/// Where and how the grammar stopped.
#[derive(Clone, Copy)]
struct Stopped {
    /// The position of the token at which the grammar stopped.
    at: usize,
    /// Whether the line could have ended in front of that token.
    can_end: bool,
    /// Whether a reserved keyword stands at that token in place of a name.
    reserved: bool,
}

impl<'t> Driver<'t> {
    fn kind(&self, index: usize) -> Option<Kind> {
        self.tokens.get(index).map(|(kind, _)| *kind)
    }

    fn word(&self, index: usize) -> Option<Word> {
        match self.kind(index) {
            Some(Kind::Word(word)) => Some(word),
            _ => None,
        }
    }

    /// The span of a token; behind the last token, an empty span at the end of the text.
    fn span(&self, index: usize) -> Span {
        self.tokens
            .get(index)
            .map_or_else(|| Span::new(self.source.text().len(), self.source.text().len()), |(_, span)| *span)
    }

    fn text(&self, index: usize) -> &'t str {
        self.source.slice(self.span(index))
    }

    /// Whether the token may be a name.
    fn is_name(&self, index: usize) -> bool {
        self.kind(index).is_some_and(Kind::may_be_name)
    }

    /// Whether a token is the first of its line.
    fn is_first_of_line(&self, index: usize) -> bool {
        index == 0 || {
            let (before, here) = (self.span(index - 1), self.span(index));
            self.source.text()[before.end as usize..here.start as usize].contains('\n')
        }
    }

    /// Whether a declaration of the file begins at this token.
    fn is_declaration(&self, index: usize) -> bool {
        match self.word(index) {
            Some(Word::Task | Word::Type | Word::Cell) => true,
            Some(word) if Word::DECLARATIONS.contains(&word) => {
                let follows = self.kind(index + 1);
                let names =
                    matches!(follows, Some(Kind::Assign | Kind::Dot | Kind::Equal | Kind::BracketOpen));
                let begins = index == 0
                    || self.kind(index - 1) == Some(Kind::Semicolon)
                    || self.is_first_of_line(index);
                begins && !names
            }
            _ => false,
        }
    }

    /// A token, as the diagnostics need it.
    fn found(&self, index: usize) -> Found<'t> {
        let after = if index == 0 { Span::default() } else { self.span(index - 1) };
        Found {
            kind: self.kind(index),
            text: self.text(index),
            span: self.span(index),
            after,
            first_of_line: self.is_first_of_line(index),
        }
    }

    /// Whether these tokens contain the place of an earlier diagnostic.
    fn is_faulty(&self, from: usize, to: usize) -> bool {
        let (begin, end) = (self.span(from).start, self.span(to).start);
        let first = self.faulty.partition_point(|place| *place < begin);
        self.faulty.get(first).is_some_and(|place| *place < end.max(begin + 1))
    }

    /// Has the grammar parse the tokens from `from` to `to`, and reports errors. `end` should follow these tokens.
    fn read<O>(&mut self, line: fn(&Self) -> &Line<'t, O>, from: usize, to: usize, end: &str) -> Read<O> {
        let tokens = &self.tokens[from..to];
        let last = Span { start: self.span(to).start, end: self.span(to).start };
        let (output, failures) = line(self).parse(tokens.split_token_span(last)).into_output_errors();
        let known = self.is_faulty(from, to);
        let (mut stopped, mut said) = (None, false);
        for failure in failures {
            match failure {
                Failure::Said(found) => {
                    said = true;
                    if !self.faulty.contains(&found.primary.span.start) {
                        self.report.push(|| *found);
                    }
                }
                Failure::Unexpected { span, expected } => {
                    let at = from + tokens.partition_point(|(_, token)| token.start < span.start);
                    let found = self.found(at);
                    if !(known || self.open_ended && found.kind.is_none()) {
                        self.report.push(|| failure::unexpected(&expected, &found, end));
                    }
                    let can_end = expected.contains(&failure::Expected::End);
                    let reserved = matches!(found.kind, Some(Kind::Word(word)) if word.is_reserved())
                        && failure::wants_name(&expected);
                    stopped = Some(Stopped { at, can_end, reserved });
                }
            }
        }
        if output.is_none() || known || said {
            self.lose(from, to);
        }
        Read { output, stopped }
    }

    /// Records that these tokens could not be parsed.
    fn lose(&mut self, from: usize, to: usize) {
        let last = self.span(to.saturating_sub(1).max(from));
        self.lost.spans.push(self.span(from).to(last));
    }

    /// The token at `from` or later that ends the line: its `;`, or a word that cannot be part of the line.
    fn reach(&self, from: usize, context: Context) -> usize {
        let rest = from..self.tokens.len();
        rest.into_iter().find(|index| self.ends_line(*index, context)).unwrap_or(self.tokens.len())
    }

    fn ends_line(&self, index: usize, context: Context) -> bool {
        if self.kind(index) == Some(Kind::Semicolon) {
            return true;
        }
        let Some(word) = self.word(index) else { return false };
        if matches!(
            word,
            Word::Task | Word::Type | Word::Cell | Word::Begin | Word::End | Word::UsePort | Word::Var
        ) {
            return true;
        }
        // A keyword that is not reserved ends the line only if it is the first word of a new line.
        let begins = word.is_reserved() || self.is_first_of_line(index) && self.is_name(index + 1);
        let of_statement =
            Word::STATEMENTS.contains(&word) && begins || matches!(word, Word::Then | Word::Do);
        match context {
            Context::Top => {
                self.is_first_of_line(index) && (word == Word::Port || self.is_declaration(index))
            }
            Context::Field => word == Word::Port,
            // As in `usage = send`: a keyword behind `=` does not begin a statement.
            Context::Head => {
                word == Word::Port || of_statement && index > 0 && self.kind(index - 1) != Some(Kind::Equal)
            }
            Context::Body => word == Word::Port || of_statement,
        }
    }

    /// Parses a line up to its `;`.
    fn line<O>(&mut self, line: fn(&Self) -> &Line<'t, O>, context: Context) -> Option<O> {
        let from = self.at;
        let to = self.reach(from + 1, context);
        let read = self.read(line, from, to, ";");
        self.lost.outside |= context == Context::Top && read.output.is_none();
        match read.stopped {
            None => self.semicolon(from, to),
            Some(stopped) => self.recover(from, to, stopped),
        }
        if context == Context::Head && !self.is_behind_semicolon() {
            self.skip_rest();
        }
        if read.stopped.is_some() {
            self.broken = self.at;
        }
        read.output
    }

    /// Continues behind the `;` that should end the line, and reports a missing `;`.
    fn semicolon(&mut self, from: usize, to: usize) {
        self.at = to;
        if self.kind(to) == Some(Kind::Semicolon) {
            self.at += 1;
        } else if !(self.is_faulty(from, to) || self.open_ended && to == self.tokens.len()) {
            let found = self.found(to);
            self.report.push(|| failure::missing_semicolon(&found));
        }
    }

    /// Skips the rest of a line that could not be parsed, up to a keyword that begins something else.
    fn skip_rest(&mut self) {
        while self.at < self.tokens.len() && !self.is_first_of_line(self.at) {
            match self.kind(self.at) {
                Some(Kind::Semicolon) => {
                    self.at += 1;
                    return;
                }
                Some(Kind::Word(Word::Port | Word::UsePort | Word::Var | Word::Begin | Word::End)) => return,
                _ => self.at += 1,
            }
        }
    }

    /// Whether the last token is a `;`.
    fn is_behind_semicolon(&self) -> bool {
        self.at > 0 && self.kind(self.at - 1) == Some(Kind::Semicolon)
    }

    /// Continues behind a line that could not be parsed.
    fn recover(&mut self, from: usize, to: usize, stopped: Stopped) {
        if stopped.can_end && stopped.at > from && self.is_first_of_line(stopped.at) {
            self.at = stopped.at;
            return;
        }
        self.at = to;
        if stopped.reserved && stopped.at == to && !self.is_first_of_line(to) {
            // If a reserved keyword stands in place of a name, the line continues behind this keyword.
            let mut index = to + 1;
            while index < self.tokens.len() && !self.is_first_of_line(index) {
                if matches!(
                    self.kind(index),
                    Some(Kind::Semicolon | Kind::Word(Word::On | Word::Do | Word::Then))
                ) {
                    self.at = index;
                    break;
                }
                index += 1;
            }
        }
        if self.kind(self.at) == Some(Kind::Semicolon) {
            self.at += 1;
        }
    }

    /// Reports the next token as unexpected. `help` says what to write.
    fn unexpected(&mut self, code: &'static str, help: &str, message: impl FnOnce(&Found<'t>) -> String) {
        let found = self.found(self.at);
        if !self.is_faulty(self.at, self.at + 1) {
            self.report.push(|| Diagnostic::error(code, found.span, message(&found)).help(help));
        }
    }

    /// Skips superfluous `;` and reports them once.
    fn stray_semicolons(&mut self) {
        if self.broken != self.at {
            self.unexpected(crate::codes::UNEXPECTED, "remove it", |_| {
                "nothing stands in front of this `;`".to_owned()
            });
        }
        while self.kind(self.at) == Some(Kind::Semicolon) {
            self.at += 1;
        }
    }
}
