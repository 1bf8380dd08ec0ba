//! Lowers a task to its script: body, take-over and handlers.

use super::Script;
use super::actions::Uses;
use super::emit::Emitter;
use super::silence::{self, Silence};
use super::units::Clock;
use crate::codes::{MALFORMED, TOO_MANY};
use crate::diagnostic::Diagnostic;
use crate::hir::{Capture, Captured, CoupleKind, Handler, Hir, Statement, Task, Trigger};
use crate::walk;
use imrs_protocol::TaskId;
use imrs_protocol::script::{self, Address, Label, Op, ProgramError, Slot};
use std::sync::Arc;

/// Emits the script of one task.
pub(super) struct Writer<'h, 'c> {
    pub hir: &'h Hir,
    pub id: TaskId,
    pub task: &'h Task,
    pub clock: &'c mut Clock,
    pub emit: Emitter,
    pub silences: Vec<Silence>,
    /// The values that the current thread saves.
    pub captures: &'h [Capture],
    pub uses: Uses,
    /// How many atomic sections are open.
    pub atomic: usize,
    /// For each open loop, the label behind the loop, and how many atomic sections are open there.
    pub loops: Vec<(Label, usize)>,
    pub errors: Vec<Diagnostic>,
}

pub(super) fn script(hir: &Hir, id: TaskId, clock: &mut Clock) -> Result<Script, Box<Diagnostic>> {
    let task = &hir.tasks[id.index()];
    let mut emit = Emitter::new(&task.name);
    for variable in &task.variables {
        emit.builder.variable(&variable.name, variable.of);
    }
    for timer in &task.timers {
        emit.builder.timer(&timer.name);
    }
    let mut silences = Silence::all(task, |length| clock.time_out(length));
    silence::keep(&mut silences, &mut emit);
    let (captures, uses) = (&task.captures[..], Uses::default());
    let (atomic, loops, errors) = (0, Vec::new(), Vec::new());
    let mut writer = Writer { hir, id, task, clock, emit, silences, captures, uses, atomic, loops, errors };
    writer.body();
    if let Some(takeover) = &task.takeover {
        writer.takeover(takeover);
    }
    for handler in &task.handlers {
        writer.handler(handler);
    }
    writer.finish()
}

impl<'h> Writer<'h, '_> {
    fn body(&mut self) {
        // An `order` at the beginning of the body counts from the start of the task on, even while the task waits for its
        // lease.
        let (orders, rest) = walk::orders_and_rest(self.task);
        self.statements(orders);
        self.emit.at = self.task.span;
        if self.is_primary() {
            self.emit.op(Op::Lease);
        }
        let silences = std::mem::take(&mut self.silences);
        silences.iter().for_each(|silence| silence.begin(&mut self.emit));
        self.silences = silences;
        self.statements(rest);
        self.emit.at = self.task.span;
        if walk::only_serves(self.task) {
            self.serve();
        }
        self.emit.op(Op::End);
        self.emit.flush();
    }

    /// Emits an endless plain `receive` for a task that has only handlers. Each handler may interrupt this `receive`.
    fn serve(&mut self) {
        let top = self.emit.label();
        self.emit.put(top);
        self.emit.op(Op::Statement);
        self.emit.op(Op::Get { port: None, source: None, time_out: None });
        self.emit.jump(top);
    }

    /// Whether the task needs a lease from its beginning on (D61).
    fn is_primary(&self) -> bool {
        self.hir.couples.iter().any(|couple| match couple.kind {
            CoupleKind::Work { primary, .. } => primary == self.id,
            CoupleKind::Loose { .. } | CoupleKind::Tight(_) | CoupleKind::Serial(..) => false,
        })
    }

    fn takeover(&mut self, statements: &'h [Statement]) {
        let at = self.task.span;
        self.within(|writer| {
            writer.restart(|_| true);
            writer.statements(statements);
            writer.emit.at = at;
        });
    }

    /// Emits the operations of `write` as the take-over's: while `write` runs, the take-over's emitter replaces the emitter
    /// of this writer.
    fn within(&mut self, write: impl FnOnce(&mut Self)) {
        let at = self.task.span;
        let mut emit = std::mem::replace(&mut self.emit, Emitter::new(""));
        emit.takeover(at, |inner| {
            std::mem::swap(&mut self.emit, inner);
            write(self);
            std::mem::swap(&mut self.emit, inner);
        });
        self.emit = emit;
    }

    fn handler(&mut self, handler: &'h Handler) {
        let trigger = match handler.trigger {
            Trigger::Message(port) => script::Trigger::Message(port),
            Trigger::Silence { timer, .. } | Trigger::Expiry(timer) => script::Trigger::Timer(timer),
            Trigger::Fence => script::Trigger::Fenced,
        };
        self.captures = &handler.captures;
        let mut emit = std::mem::replace(&mut self.emit, Emitter::new(""));
        emit.handler(trigger, handler.span, |inner| {
            std::mem::swap(&mut self.emit, inner);
            self.handler_body(handler);
            std::mem::swap(&mut self.emit, inner);
        });
        self.emit = emit;
    }

    fn handler_body(&mut self, handler: &'h Handler) {
        for local in &handler.locals {
            self.emit.builder.local(&local.name, local.of);
        }
        if let Trigger::Message(port) = handler.trigger {
            if handler.reads > 0 {
                let fields = self.hir.ports[port.index()].message.iter().map(|field| field.of);
                let format = self.emit.builder.format(&fields.collect::<Vec<_>>());
                let places = (0..handler.reads).filter_map(|at| u16::try_from(at).ok()).map(Slot::Local);
                let into = self.emit.builder.places(&places.collect::<Vec<_>>());
                self.emit.op(Op::Unpack { format, into });
            }
            self.keep_source();
            self.restart(|silence| silence.port == port);
        }
        self.statements(&handler.body);
        self.emit.at = handler.span;
        if let Trigger::Silence { timer, .. } = handler.trigger {
            self.restart(|silence| silence.timer == timer);
        }
    }

    /// For each handler `on silence .. when ..` that `which` selects: emits the restart of its timer, if its condition holds.
    pub fn restart(&mut self, which: impl Fn(&Silence) -> bool) {
        let silences = std::mem::take(&mut self.silences);
        silences.iter().filter(|silence| which(silence)).for_each(|silence| silence.restart(&mut self.emit));
        self.silences = silences;
    }

    /// Emits the saving of a message's sender, port and number, if an expression reads them.
    pub fn keep_source(&mut self) {
        for capture in self.captures {
            let op = match capture.what {
                Captured::Sender => Op::ReceivedSource,
                Captured::Received => Op::ReceivedPort,
                Captured::Ticket => Op::ReceivedId,
                Captured::Outcome | Captured::Answered(..) | Captured::Refused(..) | Captured::Told(..) => {
                    continue;
                }
            };
            self.emit.op(op);
            self.emit.op(Op::Store(capture.slot));
        }
    }

    fn finish(mut self) -> Result<Script, Box<Diagnostic>> {
        if let Some(found) = self.errors.pop() {
            return Err(Box::new(found));
        }
        let (task, length) = (self.task, self.emit.spans.len());
        let large = length > usize::from(Address::MAX);
        let too_large = |what: &str| {
            Diagnostic::error(TOO_MANY, task.span, format!("task `{}` is too large: {what}", task.name))
                .label("too large for a script")
                .help("split it into several tasks")
        };
        let finished = self.emit.finish().map_err(|error| match error {
            _ if large => too_large(&format!("{length} operations, at most {}", Address::MAX)),
            ProgramError::TooLarge => too_large("too many handlers or timers"),
            ProgramError::Operands(_) => too_large("an expression is too deep"),
            other => {
                let message = format!("the script of `{}` does not pass its check: {other}", task.name);
                Diagnostic::error(MALFORMED, task.span, message)
                    .label("a fault of the compiler")
                    .help("please report it, with the file")
            }
        });
        let (program, spans) = finished.map_err(Box::new)?;
        let actions = self.uses.actions(self.hir, self.id, &program);
        let handlers = self.task.handlers.iter().map(|handler| handler.span).collect();
        Ok(Script { program: Arc::new(program), spans, handlers, actions })
    }
}
