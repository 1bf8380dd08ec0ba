//! Parses statements: blocks, and the lines inside of them.

use super::failure::{clip, unexpected};
use super::{Context, Driver, Opener, limits};
use crate::ast::{Branch, Handler, Statement, StatementKind, TaskDecl};
use crate::codes::{LIMIT, MISPLACED, STRAY_END, UNEXPECTED};
use crate::diagnostic::Diagnostic;
use crate::foreign;
use crate::lexer::Kind;
use crate::parser::lines::Line;
use crate::span::Span;
use crate::words::Word;

impl<'t> Driver<'t> {
    /// Parses the handlers and statements of a task, and its `takeover`.
    pub(super) fn task_body(&mut self, task: &mut TaskDecl) {
        let mut takeover: Option<Vec<Statement>> = None;
        loop {
            let into = takeover.as_mut().unwrap_or(&mut task.body);
            let handlers = &mut task.handlers;
            self.statements(into, Some(handlers));
            match self.word(self.at) {
                Some(Word::Takeover) => {
                    if takeover.is_some() {
                        self.unexpected(MISPLACED, "put all of it behind the first one", |_| {
                            "a task has one `takeover`".to_owned()
                        });
                    }
                    self.at += 1;
                    takeover.get_or_insert_default();
                }
                Some(Word::End) if self.is_stray_end() => {
                    self.unexpected(
                        STRAY_END,
                        "remove it, or write the `if`, `loop` or `do` that it closes",
                        |_| "this `end` closes nothing".to_owned(),
                    );
                    self.at += 1;
                    if self.kind(self.at) == Some(Kind::Semicolon) {
                        self.at += 1;
                    }
                }
                _ => break,
            }
        }
        task.takeover = takeover;
    }

    /// Whether the `end` here closes no block: neither a name, a declaration nor the end of the file follows it.
    fn is_stray_end(&self) -> bool {
        let behind = if self.kind(self.at + 1) == Some(Kind::Semicolon) { self.at + 2 } else { self.at + 1 };
        !self.is_name(self.at + 1) && behind < self.tokens.len() && !self.is_declaration(behind)
    }

    /// Parses statements up to a word that ends them: `end`, `else`, `takeover`, or a word that cannot stand in a task.
    /// Handlers go into `handlers`; without `handlers` they are reported as misplaced.
    fn statements(&mut self, into: &mut Vec<Statement>, mut handlers: Option<&mut Vec<Handler>>) {
        while let Some(kind) = self.kind(self.at) {
            if self.report.is_enough() {
                self.at = self.tokens.len();
                return;
            }
            match kind {
                Kind::Word(Word::End | Word::Task | Word::Type | Word::Cell) => return,
                Kind::Word(Word::Takeover) => return,
                Kind::Word(Word::Else | Word::Elsif) => {
                    if self.open.iter().any(|opener| opener.word == Word::If) {
                        return;
                    }
                    self.unexpected(
                        MISPLACED,
                        "write `if .. then` in front of it, or remove an `end` there",
                        |found| format!("{} belongs to no `if`", found.describe()),
                    );
                    self.at = self.reach(self.at + 1, Context::Body);
                    if matches!(self.word(self.at), Some(Word::Then)) {
                        self.at += 1;
                    }
                }
                Kind::Semicolon => self.stray_semicolons(),
                Kind::Word(Word::On) => self.on(into, &mut handlers),
                Kind::Word(Word::Port | Word::UsePort | Word::Var) => {
                    self.unexpected(MISPLACED, "move it there", |found| {
                        format!("{} stands in front of `begin`", found.describe())
                    });
                    let from = self.at;
                    self.at = self.reach(self.at + 1, Context::Head);
                    self.lose(from, self.at);
                    if self.kind(self.at) == Some(Kind::Semicolon) {
                        self.at += 1;
                    }
                }
                _ if self.is_declaration(self.at) => return,
                _ => self.statement(into),
            }
        }
    }

    /// Parses `on` at the beginning of a statement: a handler, or a branch that a wrong `;` separates from its statement.
    fn on(&mut self, into: &mut [Statement], handlers: &mut Option<&mut Vec<Handler>>) {
        if matches!(self.word(self.at + 1), Some(Word::TimeOut | Word::Refused | Word::Failed)) {
            let branch = self.source.slice(self.span(self.at).to(self.span(self.at + 1)));
            let span = self.span(self.at);
            if self.broken != self.at {
                self.report.push(|| {
                    let message = format!("`{branch}` belongs to the statement in front of it");
                    Diagnostic::error(MISPLACED, span, message).help("remove the `;` in front of it")
                });
            }
            while self.is_branch(self.at) {
                if let Some(branch) = self.branch()
                    && let Some(last) = into.last_mut()
                {
                    last.branches.push(branch);
                }
            }
            self.semicolon_of_end();
            return;
        }
        let from = self.at;
        if handlers.is_none() {
            self.unexpected(
                MISPLACED,
                "move it out of the block: behind `begin`, or behind the `end` of a statement",
                |_| "a handler stands in no block of a task".to_owned(),
            );
        }
        let trigger = self.head(|d| &d.statements.trigger, from + 1, Word::Do);
        let span = self.head_span(from, Word::Do);
        let body = self.block(Opener { word: Word::On, span: self.span(from) });
        self.semicolon_of_end();
        match (trigger, handlers) {
            (Some(trigger), Some(handlers)) => handlers.push(Handler { trigger, body, span }),
            (None, _) | (_, None) => self.lose(from, self.at),
        }
    }

    fn statement(&mut self, into: &mut Vec<Statement>) {
        let from = self.at;
        match self.kind(from) {
            Some(Kind::Word(Word::If)) => self.if_block(into),
            Some(Kind::Word(Word::While)) => {
                let condition = self.head(|d| &d.lines.condition, from + 1, Word::Do);
                let span = self.head_span(from, Word::Do);
                let body = self.block(Opener { word: Word::While, span: self.span(from) });
                self.finish(condition.map(|condition| StatementKind::While(condition, body)), span, into);
            }
            Some(Kind::Word(word @ (Word::Loop | Word::Atomic))) => {
                let span = self.span(from);
                self.at += 1;
                let body = self.block(Opener { word, span });
                let kind =
                    if word == Word::Loop { StatementKind::Loop(body) } else { StatementKind::Atomic(body) };
                self.finish(Some(kind), span, into);
            }
            _ if self.is_name(from)
                && matches!(self.kind(from + 1), Some(Kind::Assign | Kind::Dot | Kind::Equal)) =>
            {
                self.simple(|d| &d.statements.assignment, into);
            }
            Some(Kind::Word(word)) if Word::STATEMENTS.contains(&word) => {
                self.simple(|d| &d.statements.command, into);
            }
            _ if self.is_name(from) => self.unknown_statement(),
            Some(Kind::Word(word)) if self.kind(from + 1) == Some(Kind::Assign) && word.is_reserved() => {
                self.reserved_name(from);
                self.skip_line(from + 1);
            }
            _ => {
                self.unexpected(
                    UNEXPECTED,
                    "write a statement, such as `send p(x);` or `x := 1;`, or remove this",
                    |found| format!("expected a statement, found {}", found.describe()),
                );
                self.skip_line(from + 1);
                self.broken = self.at;
            }
        }
        self.at = self.at.max(from + 1);
    }

    /// Parses a statement of one line, with its branches.
    fn simple(&mut self, line: fn(&Self) -> &Line<'t, StatementKind>, into: &mut Vec<Statement>) {
        let from = self.at;
        let to = self.reach(from + 1, Context::Body);
        let read = self.read(line, from, to, ";");
        let span = self.span(from).to(self.span(to - 1));
        let branches = self.is_branch(to) || read.stopped.is_some() && self.word(to) == Some(Word::Do);
        match read.stopped {
            Some(stopped) if !branches => self.recover(from, to, stopped),
            None if !branches => self.semicolon(from, to),
            Some(_) | None => self.at = to,
        }
        let branches = branches || !self.is_behind_semicolon() && self.is_branch(self.at);
        if read.stopped.is_some() {
            self.broken = self.at;
        }
        let mut statement = read.output.map(|kind| Statement { kind, branches: Vec::new(), span });
        if branches {
            while self.is_branch(self.at) || self.word(self.at) == Some(Word::Do) || self.skips_end() {
                let branch = self.branch();
                if let (Some(statement), Some(branch)) = (&mut statement, branch) {
                    statement.branches.push(branch);
                }
            }
            self.semicolon_of_end();
        }
        into.extend(statement);
    }

    /// Skips a superfluous `end` between two branches of a statement.
    fn skips_end(&mut self) -> bool {
        let stray = self.word(self.at) == Some(Word::End)
            && self.word(self.at + 1) == Some(Word::On)
            && self.is_branch(self.at + 1);
        if stray {
            self.unexpected(STRAY_END, "remove it", |_| "this `end` closes nothing".to_owned());
            self.at += 1;
        }
        stray
    }

    /// Whether a branch of a statement begins here: `on time_out`, or `time_out do` without the `on` in front.
    fn is_branch(&self, index: usize) -> bool {
        let of_branch = matches!(self.word(index), Some(Word::TimeOut | Word::Refused | Word::Failed));
        self.word(index) == Some(Word::On) && !self.is_handler(index)
            || of_branch && self.word(index + 1) == Some(Word::Do)
    }

    /// Whether the `on` at this position begins a handler.
    fn is_handler(&self, index: usize) -> bool {
        matches!(
            self.word(index + 1),
            Some(Word::Query | Word::Receive | Word::Silence | Word::Expiry | Word::Fence)
        )
    }

    fn branch(&mut self) -> Option<Branch> {
        let from = self.at;
        if self.word(from) != Some(Word::On) {
            // The `on` is missing, or the line in front of this one could not be parsed.
            if self.word(from) != Some(Word::Do) {
                self.unexpected(UNEXPECTED, "write `on` in front of it", |found| {
                    format!("expected `on` or `;`, found {}", found.describe())
                });
                self.at += 1;
            }
            self.at += 1;
            self.block(Opener { word: Word::On, span: self.span(from) });
            self.lose(from, self.at);
            return None;
        }
        let when = self.head(|d| &d.statements.branch, from + 1, Word::Do);
        let span = self.head_span(from, Word::Do);
        let body = self.block(Opener { word: Word::On, span: self.span(from) });
        if when.is_none() {
            self.lose(from, self.at);
        }
        when.map(|when| Branch { when, body, span })
    }

    /// Parses a line that begins with an unknown word. If the line opens a block, the block is parsed and dropped.
    fn unknown_statement(&mut self) {
        let from = self.at;
        let name = self.text(from);
        let follows = self.kind(from + 1);
        let (span, known) = (self.span(from), self.is_faulty(from, from + 1));
        if !known {
            self.report.push(|| foreign::unknown_statement(name, &clip(name), span, follows));
        }
        self.at = self.reach(from + 1, Context::Body);
        match self.word(self.at) {
            Some(Word::Do | Word::Then) => {
                self.at += 1;
                self.block(Opener { word: Word::Do, span });
                self.semicolon_of_end();
            }
            Some(Word::On) if !self.is_handler(self.at) => {
                self.branch();
                self.semicolon_of_end();
            }
            _ => self.skip_line(self.at),
        }
        self.lose(from, self.at);
    }

    /// Skips an unusable line, with its `;`, `then` or `do`.
    fn skip_line(&mut self, from: usize) {
        self.at = self.reach(from, Context::Body);
        self.lose(from.saturating_sub(1), self.at);
        if matches!(self.kind(self.at), Some(Kind::Semicolon | Kind::Word(Word::Then | Word::Do))) {
            self.at += 1;
        }
    }

    /// Parses `if`, with its `elsif` and `else`.
    fn if_block(&mut self, into: &mut Vec<Statement>) {
        let from = self.at;
        let opener = Opener { word: Word::If, span: self.span(from) };
        let mut arms = Vec::new();
        let mut otherwise = None;
        let mut readable = true;
        let condition = self.head(|d| &d.lines.condition, from + 1, Word::Then);
        let span = self.head_span(from, Word::Then);
        let mut body = self.open_block(opener);
        readable &= condition.is_some();
        arms.extend(condition.map(|condition| (condition, std::mem::take(&mut body))));
        loop {
            match self.word(self.at) {
                Some(word @ (Word::Elsif | Word::Else)) if otherwise.is_some() => {
                    self.unexpected(MISPLACED, "move it in front of the `else`", |_| {
                        format!("`{}` behind the `else`", word.text())
                    });
                    self.skip_line(self.at + 1);
                    self.open_block(opener);
                }
                Some(Word::Elsif) => {
                    let condition = self.head(|d| &d.lines.condition, self.at + 1, Word::Then);
                    let body = self.open_block(opener);
                    readable &= condition.is_some();
                    arms.extend(condition.map(|condition| (condition, body)));
                }
                Some(Word::Else) => {
                    self.at += 1;
                    otherwise = Some(self.open_block(opener));
                }
                _ => break,
            }
        }
        self.block_end(opener);
        self.finish(readable.then_some(StatementKind::If { arms, otherwise }), span, into);
    }

    /// Expects the `;` behind a block statement. Adds the statement, or records its span as lost.
    fn finish(&mut self, kind: Option<StatementKind>, span: Span, into: &mut Vec<Statement>) {
        self.semicolon_of_end();
        if kind.is_none() {
            let end = self.span(self.at.saturating_sub(1)).end;
            self.lost.spans.push(Span { start: span.start, end: end.max(span.end) });
        }
        into.extend(kind.map(|kind| Statement { kind, branches: Vec::new(), span }));
    }

    /// Parses the statements of a block, and its `end`.
    fn block(&mut self, opener: Opener) -> Vec<Statement> {
        let body = self.open_block(opener);
        self.block_end(opener);
        body
    }

    /// Parses the statements of a block.
    fn open_block(&mut self, opener: Opener) -> Vec<Statement> {
        let mut body = Vec::new();
        if self.open.len() > limits::DEEPEST {
            // The limit check counts openers, so missing `do`s can hide how deep the blocks are.
            self.report.push(|| {
                Diagnostic::error(LIMIT, opener.span, "too many blocks are nested here")
                    .help("split the task, or close the blocks above")
            });
            self.at = self.tokens.len();
            return body;
        }
        self.open.push(opener);
        self.statements(&mut body, None);
        self.open.pop();
        body
    }

    /// Expects the `end` of a block.
    fn block_end(&mut self, opener: Opener) {
        if self.word(self.at) != Some(Word::End) {
            self.unclosed(opener);
            return;
        }
        let named = self.at + 1;
        if self.is_name(named)
            && !self.is_branch(named)
            && (!self.is_first_of_line(named) || self.kind(named + 1) == Some(Kind::Semicolon))
        {
            self.unclosed(opener);
            return;
        }
        let (end, begin) = (self.span(self.at), opener.span);
        let (indent_end, is_first) = self.source.indentation(end.start);
        let (indent_begin, _) = self.source.indentation(begin.start);
        if is_first && indent_end != indent_begin {
            self.suspects.push((opener, end));
        }
        self.at += 1;
        let closes = self.word(self.at);
        if matches!(closes, Some(Word::If | Word::While | Word::Loop | Word::Atomic | Word::On))
            && !self.is_first_of_line(self.at)
            && self.kind(self.at + 1) == Some(Kind::Semicolon)
        {
            self.unexpected(STRAY_END, "write `end;`", |_| "a block is closed by `end` alone".to_owned());
            self.at += 1;
        }
    }

    /// Parses a head: the part between a block's first keyword and its `then` or `do`. Skips the `then` or `do`, too.
    fn head<O>(&mut self, line: fn(&Self) -> &Line<'t, O>, from: usize, then: Word) -> Option<O> {
        // The word behind `on` may be the keyword of a statement: `on query`.
        let scan = if self.word(from - 1) == Some(Word::On) && self.kind(from) != Some(Kind::Semicolon) {
            from + 1
        } else {
            from
        };
        let to = self.reach(scan.min(self.tokens.len()), Context::Body);
        let read = self.read(line, from.min(to), to, then.text());
        self.at = to;
        let here = self.word(to);
        if here != Some(then) && read.stopped.is_none() && !self.is_faulty(from, to) {
            let found = self.found(to);
            let wanted = [super::failure::Expected::Token(Kind::Word(then))];
            self.report.push(|| unexpected(&wanted, &found, ";"));
        }
        if matches!(here, Some(Word::Then | Word::Do)) || self.kind(to) == Some(Kind::Semicolon) {
            self.at += 1;
        }
        read.output
    }

    /// The span from the first word of a head to the word in front of its `then` or `do`.
    fn head_span(&self, from: usize, then: Word) -> Span {
        let last = self.at.saturating_sub(1).max(from);
        let last = if self.word(last) == Some(then) { last.saturating_sub(1).max(from) } else { last };
        self.span(from).to(self.span(last))
    }
}
