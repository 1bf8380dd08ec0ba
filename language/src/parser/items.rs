//! Parses the file, its types and its tasks: the declarations with blocks.

use super::failure::{missing_semicolon, reserved};
use super::lines::TaskHead;
use super::{Context, Driver, Opener};
use crate::ast::{Field, File, Item, Name, PortDecl, PortOption, TaskDecl, TypeDecl};
use crate::codes::{MISPLACED, MISSPELT, STRAY_END, UNCLOSED_BLOCK, UNEXPECTED};
use crate::diagnostic::Diagnostic;
use crate::foreign;
use crate::lexer::Kind;
use crate::span::Span;
use crate::words::Word;

/// How many tokens of a task's head the parser searches for the `begin`.
const LONGEST_HEAD: usize = 2000;

impl Driver<'_> {
    /// Parses the whole file.
    pub(super) fn file(&mut self) -> File {
        let mut file = File::default();
        if self.word(0) == Some(Word::Cell) {
            file.name = self.line(|d| &d.lines.cell, Context::Top);
        } else if !(self.open_ended && self.tokens.is_empty()) {
            self.unexpected(
                UNEXPECTED,
                "write `cell` and its name in front of this: `cell my_cell;`",
                |found| format!("a cell file begins with `cell name;`, found {}", found.describe()),
            );
            self.faulty.insert(0, self.span(0).start);
        }
        while self.at < self.tokens.len() && !self.report.is_enough() {
            let (from, lost) = (self.at, self.lost.spans.len());
            let shapes = match self.word(from) {
                Some(Word::Node | Word::Link | Word::Tick | Word::Model) => true,
                Some(word) => !Word::DECLARATIONS.contains(&word),
                None => true,
            };
            self.lost.items.push((self.span(from).start, shapes));
            match self.item() {
                Some(item) => file.items.push(item),
                None if self.at > from && self.kind(from) != Some(Kind::Semicolon) => {
                    self.lost.spans.truncate(lost);
                    self.lose(from, self.at);
                    self.lost.outside = true;
                }
                None => {}
            }
        }
        file
    }

    fn item(&mut self) -> Option<Item> {
        match self.kind(self.at) {
            Some(Kind::Word(Word::Task)) => self.task().map(Item::Task),
            Some(Kind::Word(Word::Type)) => self.record().map(Item::Type),
            Some(Kind::Word(Word::Cell)) => {
                self.unexpected(MISPLACED, "remove this one, or put it into a file of its own", |_| {
                    "a file has one `cell`, in its first line".to_owned()
                });
                self.line(|d| &d.lines.cell, Context::Top);
                None
            }
            Some(Kind::Word(word)) if Word::DECLARATIONS.contains(&word) => {
                self.line(|d| &d.lines.item, Context::Top)
            }
            Some(Kind::Semicolon) => {
                self.stray_semicolons();
                None
            }
            _ => {
                self.no_declaration();
                None
            }
        }
    }

    /// Reports that a declaration was expected. Skips to the next declaration, or only the line if an unknown word begins it.
    fn no_declaration(&mut self) {
        let is_line = self.is_name(self.at)
            && !matches!(self.kind(self.at + 1), Some(Kind::Assign | Kind::Dot | Kind::Equal));
        let code = if is_line { MISSPELT } else { UNEXPECTED };
        let help = foreign::declaration(self.text(self.at));
        self.unexpected(code, help, |found| {
            format!(
                "expected a declaration (`node`, `link`, `type`, `task`, `couple`, `faults`, `check`), found {}",
                found.describe()
            )
        });
        self.at += 1;
        while self.at < self.tokens.len() && !self.is_declaration(self.at) {
            self.at += 1;
            if is_line && self.kind(self.at - 1) == Some(Kind::Semicolon) {
                break;
            }
        }
    }

    fn record(&mut self) -> Option<TypeDecl> {
        let (from, opener) = (self.at, Opener { word: Word::Record, span: self.span(self.at) });
        let mut to = self.reach(from + 1, Context::Field);
        if let Some(length) =
            self.tokens[from..to].iter().position(|(kind, _)| *kind == Kind::Word(Word::Record))
        {
            to = from + length + 1;
        }
        let head = self.read(|d| &d.lines.type_head, from, to, "record");
        self.at = to;
        if let Some(stopped) = head.stopped
            && self.word(to - 1) != Some(Word::Record)
        {
            // Without the word `record` the parser cannot know whether fields follow.
            self.recover(from, to, stopped);
            return None;
        }
        let mut fields: Vec<Field> = Vec::new();
        loop {
            match self.kind(self.at) {
                Some(Kind::Word(Word::End)) => break,
                Some(Kind::Semicolon) => self.stray_semicolons(),
                Some(_) if !self.is_declaration(self.at) && !self.report.is_enough() => {
                    let before = self.at;
                    let line = self.line(|d| &d.lines.fields, Context::Field);
                    fields.extend(line.into_iter().flatten());
                    // A word that ends lines may stand in place of a field. The parser skips it, or this loop never ends.
                    self.at = self.at.max(before + 1);
                }
                _ => {
                    self.unclosed(opener);
                    return head.output.map(|name| TypeDecl {
                        span: opener.span.to(name.span),
                        name,
                        fields,
                    });
                }
            }
        }
        let span = opener.span.to(self.span(self.at));
        self.at += 1;
        if self.kind(self.at) == Some(Kind::Name) && !self.is_first_of_line(self.at) {
            self.unexpected(STRAY_END, "write `end;`", |_| "a record is closed by `end` alone".to_owned());
            self.at += 1;
        }
        // In Figure 1 no `;` follows the `end`.
        if self.kind(self.at) == Some(Kind::Semicolon) {
            self.at += 1;
        }
        head.output.map(|name| TypeDecl { name, fields, span })
    }

    fn task(&mut self) -> Option<TaskDecl> {
        let from = self.at;
        // An `on` directly behind the name belongs to the task's head.
        let mut to = self.reach(from + 1, Context::Head);
        if self.word(to) == Some(Word::On) && to == from + 2 {
            to = self.reach(to + 1, Context::Head);
        }
        let head = self.read(|d| &d.lines.task_head, from, to, "begin");
        self.at = to;
        if head.stopped.is_some() && self.kind(to) != Some(Kind::Semicolon) {
            self.skip_rest();
        } else if self.kind(to) == Some(Kind::Semicolon) {
            if head.stopped.is_none() {
                self.unexpected(UNEXPECTED, "remove it", |_| "no `;` ends the head of a task".to_owned());
            }
            self.at += 1;
        }
        let span = self.span(from).to(self.span(self.at.max(from + 1) - 1));
        let opener = Opener { word: Word::Task, span };
        let mut task = empty_task(head.output, span);
        self.open.clear();
        self.suspects.clear();
        if self.task_head(&mut task) {
            self.task_body(&mut task);
        }
        self.task_end(&mut task, opener);
        (!task.name.text.is_empty()).then_some(task)
    }

    /// Parses the declarations of a task in front of its `begin`. Returns whether a body follows.
    fn task_head(&mut self, task: &mut TaskDecl) -> bool {
        loop {
            match self.kind(self.at) {
                Some(Kind::Word(Word::Port | Word::UsePort)) => task.ports.extend(self.port()),
                Some(Kind::Word(Word::Var)) => {
                    task.variables.extend(self.line(|d| &d.lines.variables, Context::Head));
                }
                Some(Kind::Word(Word::Begin)) => {
                    self.at += 1;
                    return true;
                }
                Some(Kind::Word(Word::End)) => {
                    if task.is_extern.is_none() && !task.name.text.is_empty() {
                        self.unexpected(UNEXPECTED, "write `begin` in front of the `end`", |_| {
                            "expected `begin`, found `end`".to_owned()
                        });
                    }
                    return false;
                }
                Some(Kind::Semicolon) => self.stray_semicolons(),
                None => return false,
                Some(_) if self.is_declaration(self.at) || self.report.is_enough() => return false,
                Some(kind) => {
                    let help = foreign::in_task(self.text(self.at));
                    self.unexpected(UNEXPECTED, help, |found| {
                        let found = found.describe();
                        format!("expected `port`, `use_port`, `var` or `begin`, found {found}")
                    });
                    let is_statement = matches!(kind, Kind::Word(word) if Word::STATEMENTS.contains(&word));
                    if is_statement && !self.begins_later() {
                        return true;
                    }
                    let from = self.at;
                    self.at = self.reach(self.at + 1, Context::Head);
                    self.lose(from, self.at);
                    if self.kind(self.at) == Some(Kind::Semicolon) {
                        self.at += 1;
                    }
                }
            }
        }
    }

    /// Whether the `begin` of the task still follows.
    fn begins_later(&self) -> bool {
        let rest = self.at..self.tokens.len().min(self.at + LONGEST_HEAD);
        let mut words = rest.map(|index| (index, self.word(index)));
        words
            .find(|(index, word)| {
                *word == Some(Word::Begin)
                    || *word == Some(Word::End) && self.is_name(index + 1)
                    || self.is_declaration(*index)
            })
            .is_some_and(|(_, word)| word == Some(Word::Begin))
    }

    /// Parses a port. Head and options are parsed one by one, so that an error in one of them leaves the others intact.
    pub(super) fn port(&mut self) -> Option<PortDecl> {
        let from = self.at;
        let to = self.reach(from + 1, Context::Head);
        let begins: Vec<usize> = (from + 1..to).filter(|index| self.is_option(*index)).collect();
        let first = begins.first().copied().unwrap_or(to);
        let head = self.read(|d| &d.lines.port_head, from, first, ";");
        if let Some(stopped) = head.stopped
            && (stopped.reserved || first == to)
        {
            self.lose(from, to);
            self.recover(from, to, stopped);
            if !self.is_behind_semicolon() {
                self.skip_rest();
            }
            return None;
        }
        let mut options: Vec<PortOption> = Vec::new();
        let mut stopped = None;
        for (nth, begin) in begins.iter().enumerate() {
            let end = begins.get(nth + 1).copied().unwrap_or(to);
            let read = self.read(|d| &d.lines.option, *begin, end, ";");
            options.extend(read.output);
            stopped = read.stopped;
        }
        match stopped {
            Some(stopped) => self.recover(from, to, stopped),
            None => self.semicolon(from, to),
        }
        if !self.is_behind_semicolon() {
            self.lose(from, to);
            self.skip_rest();
        }
        if stopped.is_some() {
            self.broken = self.at;
        }
        let (name, parameters, answer) = head.output?;
        let owner = self.word(from) == Some(Word::Port);
        let span = self.span(from).to(self.span(to.max(1) - 1));
        Some(PortDecl { owner, name, parameters, answer, options, span })
    }

    /// Whether an option of a port begins at this token, whether a known option or not.
    fn is_option(&self, index: usize) -> bool {
        let opens = matches!(self.kind(index + 1), Some(Kind::Equal | Kind::BracketOpen));
        let known = self.word(index).is_some_and(|word| Word::OPTIONS.contains(&word));
        // The keyword of an option begins a part even if its `=` is missing. But behind `=`, or in a list, the word is a name.
        let before = self.kind(index.saturating_sub(1));
        let behind_value = !matches!(
            before,
            Some(Kind::Equal | Kind::Comma | Kind::BraceOpen | Kind::ParenOpen | Kind::Arrow | Kind::Colon)
                | Some(Kind::Word(Word::Port | Word::UsePort))
        );
        opens && self.is_name(index) || known && behind_value && !self.is_in_list(index)
    }

    /// Whether this token is in a list of names in parentheses or braces.
    fn is_in_list(&self, index: usize) -> bool {
        let back = (0..index).rev().map(|index| self.tokens[index].0);
        for kind in back {
            match kind {
                Kind::BraceOpen | Kind::ParenOpen => return true,
                Kind::BraceClose | Kind::ParenClose | Kind::Semicolon | Kind::Equal => return false,
                _ => {}
            }
        }
        false
    }

    fn task_end(&mut self, task: &mut TaskDecl, opener: Opener) {
        if self.word(self.at) != Some(Word::End) {
            self.unclosed(opener);
            return;
        }
        let name = self.at + 1;
        let known = !task.name.text.is_empty();
        if self.is_name(name) {
            let end = Name { text: self.text(name).to_owned(), span: self.span(name) };
            if known && end.text != task.name.text {
                let (end, name) = (&end, &task.name);
                self.report.push(|| wrong_end(end, name));
            }
            task.end = Some(end);
            self.semicolon(self.at, name + 1);
            return;
        }
        if known {
            let span = self.span(self.at);
            let shown = &task.name.text;
            self.report.push(|| {
                let message = format!("the end of task `{shown}` does not say its name");
                Diagnostic::error(STRAY_END, span, message).help(format!("write `end {shown};`"))
            });
        }
        self.at += 1;
        if self.kind(self.at) == Some(Kind::Semicolon) {
            self.at += 1;
        }
    }

    /// Reports a block that is not closed: this block, or one inside of it whose `end` is indented differently.
    pub(super) fn unclosed(&mut self, opener: Opener) {
        if self.open_ended {
            return;
        }
        self.left_open = Some(self.at);
        let found = self.found(self.at);
        let here = match found.kind {
            Some(Kind::Word(Word::End)) => "this closes the task".to_owned(),
            None => "the file ends here".to_owned(),
            Some(_) => format!("{} cannot stand in it", found.describe()),
        };
        let inside = self.suspects.iter().position(|(inner, _)| inner.span.start > opener.span.start);
        let suspect = inside.map(|index| self.suspects.swap_remove(index));
        let help =
            if opener.word == Word::Task { "write `end`, the task's name and `;`" } else { "write `end;`" };
        self.report.push(|| {
            let of = suspect.map_or(opener, |(inner, _)| inner);
            let message = format!("this `{}` is not closed", of.word.text());
            let diagnostic = Diagnostic::error(UNCLOSED_BLOCK, of.span, message).help(help);
            match suspect {
                Some((_, end)) => diagnostic.also(
                    end,
                    format!("this `end` closes it, but stands under the `{}`", opener.word.text()),
                ),
                None => diagnostic.also(found.span, here),
            }
        });
    }

    /// Reports a reserved keyword in place of a name.
    pub(super) fn reserved_name(&mut self, index: usize) {
        let (span, text) = (self.span(index), self.text(index));
        self.report.push(|| reserved(span, text));
    }

    /// Expects the `;` behind an `end`.
    pub(super) fn semicolon_of_end(&mut self) {
        if self.kind(self.at) == Some(Kind::Semicolon) {
            self.at += 1;
        } else if self.left_open != Some(self.at) && !(self.open_ended && self.at == self.tokens.len()) {
            let found = self.found(self.at);
            self.report.push(|| missing_semicolon(&found));
        }
    }
}

fn wrong_end(end: &Name, name: &Name) -> Diagnostic {
    let message = format!("`end {}` closes task `{}`", end.text, name.text);
    Diagnostic::error(STRAY_END, end.span, message)
        .also(name.span, "the task that is open here")
        .help(format!("write `end {};`", name.text))
}

/// A task with only its head. The task's name is empty if the head could not be parsed.
fn empty_task(head: Option<TaskHead>, span: Span) -> TaskDecl {
    let nameless = || Name { text: String::new(), span };
    let head = head.unwrap_or_else(|| TaskHead {
        name: nameless(),
        on: nameless(),
        module: None,
        standby_of: None,
        is_extern: None,
        rate: None,
    });
    TaskDecl {
        name: head.name,
        on: head.on,
        module: head.module,
        standby_of: head.standby_of,
        is_extern: head.is_extern,
        rate: head.rate,
        ports: Vec::new(),
        variables: Vec::new(),
        handlers: Vec::new(),
        body: Vec::new(),
        takeover: None,
        span,
        end: None,
    }
}
