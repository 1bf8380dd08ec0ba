//! Lowers statements to operations.

use super::outcomes::{Bad, FAILED, FENCED, REFUSED, TIMED_OUT, TOO_LATE};
use super::silence;
use super::task::Writer;
use crate::codes::{ORDER, TOO_MANY};
use crate::diagnostic::Diagnostic;
use crate::hir::{
    Answered, Captured, Destination, Duration, Expr, Field, Recipients, Statement, StatementKind,
};
use imrs_protocol::script::{Binary, Op, Outcomes, Slot, StatementOutcome, Term, Type};
use imrs_protocol::{Class, PortId, Ranked, ServiceOrder, Target, TaskId, Ticks};

impl<'h> Writer<'h, '_> {
    pub fn statements(&mut self, statements: &'h [Statement]) {
        for statement in statements {
            // A `while` marks the beginning of its statement at each iteration. For an `order`, the program's builder marks
            // the beginning.
            if !matches!(statement.kind, StatementKind::While(..) | StatementKind::Order(_)) {
                self.emit.statement(statement.span);
            }
            self.statement(statement);
        }
    }

    fn statement(&mut self, statement: &'h Statement) {
        match &statement.kind {
            StatementKind::Send { port, to, values, into, within } => {
                self.send(statement, *port, (to, *within), values, into);
            }
            StatementKind::Receive { port, into, from, within } => {
                self.receive(statement, *port, into, (*from, *within));
            }
            StatementKind::Reply { port, to, values } => self.reply(statement, *port, to, values),
            StatementKind::Waitfor { port, values, within } => {
                let format = self.message_format(*port);
                self.values(values);
                let time_out = within.map(|length| self.clock.time_out(length));
                self.emit.op(Op::Arrive { port: *port, format, time_out });
                self.keep_outcome();
                self.keep_told(*port, None);
                let name = self.hir.ports[port.index()].name.clone();
                self.branches(statement, &name, &[TIMED_OUT]);
            }
            StatementKind::Run { action, arguments, into, range, takes } => {
                self.values(arguments);
                let number = self.uses.add(&mut self.emit.builder, action, arguments, *into, *range);
                let (least, most) = self.clock.takes(*takes);
                let arguments = self.count(arguments.len(), "arguments of an action");
                self.emit.op(Op::Run { action: number, arguments, least, most });
                self.result(*into);
                self.branches(statement, action, &[FAILED]);
            }
            StatementKind::Order(ranked) => {
                self.emit.at = statement.span;
                self.order(ranked);
            }
            StatementKind::Delay(length) => {
                let length = self.clock.bound(*length);
                self.emit.op(Op::Delay(length));
            }
            StatementKind::Start { timer, length } => {
                let (timer, length) = (*timer, self.clock.bound(*length));
                self.emit.op(Op::Start { timer, length });
            }
            StatementKind::Stop(timer) => self.emit.op(Op::Stop(*timer)),
            StatementKind::Assign { to, value } => self.store(&[*to], |writer| {
                writer.emit.ops(&value.ops);
                writer.emit.op(Op::Store(to.slot));
            }),
            StatementKind::AssignAll { to, values } => self.store(to, |writer| {
                writer.values(values);
                to.iter().rev().for_each(|to| writer.emit.op(Op::Store(to.slot)));
            }),
            StatementKind::Publish { port, values } => {
                let format = self.answer_format(*port);
                self.values(values);
                self.emit.op(Op::Publish { format });
            }
            StatementKind::Published { port, into } => {
                let on = self.emit.label();
                self.emit.op(Op::Published);
                self.emit.unless(on);
                let format = self.answer_format(*port);
                self.read(format, into);
                self.emit.put(on);
            }
            StatementKind::Abort(reason) => {
                let reason = self.emit.builder.reason(reason);
                self.emit.op(Op::Abort(reason));
            }
            StatementKind::Assert(condition) => {
                self.emit.ops(&condition.ops);
                self.emit.op(Op::Assert);
            }
            StatementKind::Skip => {}
            StatementKind::Atomic(_)
            | StatementKind::If { .. }
            | StatementKind::Loop(_)
            | StatementKind::While(..)
            | StatementKind::Exit => self.control(statement),
        }
    }

    fn control(&mut self, statement: &'h Statement) {
        match &statement.kind {
            StatementKind::Atomic(body) => {
                self.emit.op(Op::Atomic(true));
                self.atomic += 1;
                self.statements(body);
                self.atomic -= 1;
                self.emit.at = statement.span;
                self.emit.op(Op::Atomic(false));
            }
            StatementKind::If { arms, otherwise } => {
                let end = self.emit.label();
                for (condition, body) in arms {
                    let next = self.emit.label();
                    self.emit.at = condition.span;
                    self.emit.ops(&condition.ops);
                    self.emit.unless(next);
                    self.statements(body);
                    self.emit.jump(end);
                    self.emit.put(next);
                }
                self.statements(otherwise);
                self.emit.put(end);
            }
            StatementKind::Loop(body) => {
                let (top, out) = (self.emit.label(), self.emit.label());
                self.emit.put(top);
                self.looped(out, body);
                self.emit.at = statement.span;
                self.emit.jump(top);
                self.emit.put(out);
            }
            StatementKind::While(condition, body) => {
                let (top, out) = (self.emit.label(), self.emit.label());
                self.emit.put(top);
                self.emit.statement(statement.span);
                self.emit.at = condition.span;
                self.emit.ops(&condition.ops);
                self.emit.unless(out);
                self.looped(out, body);
                self.emit.at = statement.span;
                self.emit.jump(top);
                self.emit.put(out);
            }
            StatementKind::Exit => {
                let Some(&(out, atomic)) = self.loops.last() else { return };
                (atomic..self.atomic).for_each(|_| self.emit.op(Op::Atomic(false)));
                self.emit.jump(out);
            }
            _ => {}
        }
    }

    fn looped(&mut self, out: imrs_protocol::script::Label, body: &'h [Statement]) {
        self.loops.push((out, self.atomic));
        self.statements(body);
        self.loops.pop();
    }

    /// Emits an `order`. The timer of an `on silence` handler ranks just behind the handler's port (D86).
    fn order(&mut self, named: &[Ranked]) {
        let mut ranked = Vec::new();
        for &level in named {
            ranked.push(level);
            let silent = self.silences.iter().filter(|silence| level == Ranked::Port(silence.port));
            ranked.extend(silent.map(|silence| Ranked::Timer(silence.timer)));
        }
        if ranked.len() > ServiceOrder::LEVELS {
            let message =
                format!("an order of {} levels; at most {} are kept", ranked.len(), ServiceOrder::LEVELS);
            let found = Diagnostic::error(ORDER, self.emit.at, message)
                .label("too many")
                .help("a port with `on silence` takes two; what is not named ranks last, all equal");
            return self.errors.push(found);
        }
        self.emit.builder.order(&ranked);
        self.emit.spans.extend([self.emit.at; 2]);
    }

    fn send(
        &mut self,
        statement: &'h Statement,
        port: PortId,
        (to, within): (&Recipients, Option<Duration>),
        values: &[Expr],
        into: &[Destination],
    ) {
        let declared = &self.hir.ports[port.index()];
        let format = self.message_format(port);
        self.values(values);
        let peers: Vec<TaskId> = match to {
            Recipients::All => declared.peers(self.id).collect(),
            Recipients::These(tasks) => tasks.clone(),
        };
        let time_out = within.map(|length| self.clock.time_out(length));
        let to = match (to, &peers[..]) {
            (Recipients::All, _) => Target::All,
            (Recipients::These(_), &[one]) => Target::One(one),
            (Recipients::These(_), several) => Target::Some(self.mask(port, several)),
        };
        self.emit.op(Op::Send { port, to, format, time_out });
        self.keep_outcome();
        self.keep_answers(port, &peers);
        if !into.is_empty() {
            let format = self.answer_format(port);
            self.unpack(format, into, None);
        }
        self.keep_told(port, Some(&peers));
        let fenced = declared.guard.map(|_| FENCED);
        let ways: Vec<Bad> = match declared.class {
            Class::Status => Vec::new(),
            Class::Command => [TIMED_OUT, REFUSED].into_iter().chain(fenced).collect(),
        };
        self.branches(statement, &declared.name, &ways);
    }

    /// The parties of a port as a bit mask.
    fn mask(&mut self, port: PortId, tasks: &[TaskId]) -> u64 {
        let mut mask = 0;
        for &task in tasks {
            let party = self.hir.ports[port.index()].party(task).and_then(|party| u32::try_from(party).ok());
            match party.and_then(|party| 1_u64.checked_shl(party)) {
                Some(bit) => mask |= bit,
                None => self.too_many("users of a port of which some are named"),
            }
        }
        mask
    }

    fn receive(
        &mut self,
        statement: &'h Statement,
        port: Option<PortId>,
        into: &[Destination],
        (source, within): (Option<TaskId>, Option<Duration>),
    ) {
        let own =
            port.and_then(|port| self.hir.ports[port.index()].user(self.id)).and_then(|user| user.time_out);
        let limits = [within, own].into_iter().flatten().map(|length| self.clock.time_out(length));
        let time_out: Option<Ticks> = limits.min();
        self.emit.op(Op::Get { port, source, time_out });
        self.keep_outcome();
        let format = port.map_or(0, |port| self.message_format(port));
        self.unpack(format, into, Some(port));
        let name = port.map_or("receive", |port| &self.hir.ports[port.index()].name);
        let limited: &[Bad] = if time_out.is_some() { &[TIMED_OUT] } else { &[] };
        self.branches(statement, name, limited);
    }

    /// Emits the unpacking of the answer or message, if one came. For a message, also saves its source and restarts the
    /// timers of its port's `on silence` handlers.
    fn unpack(&mut self, format: u16, into: &[Destination], received: Option<Option<PortId>>) {
        let keeps = |capture: &crate::hir::Capture| {
            matches!(capture.what, Captured::Sender | Captured::Received | Captured::Ticket)
        };
        let ends =
            received.is_some_and(|port| self.silences.iter().any(|s| port.is_none_or(|port| s.port == port)));
        let asks = received.is_some() && self.captures.iter().any(keeps);
        if into.is_empty() && !asks && !ends {
            return;
        }
        let (read, on) = (self.emit.label(), self.emit.label());
        self.emit.on(Outcomes::BRINGS, read);
        self.emit.jump(on);
        self.emit.put(read);
        if received.is_some() {
            self.keep_source();
        }
        if !into.is_empty() {
            self.read(format, into);
        }
        if let Some(port) = received {
            self.restart(|silence| port.is_none_or(|port| silence.port == port));
        }
        self.emit.put(on);
    }

    fn read(&mut self, format: u16, into: &[Destination]) {
        let slots: Vec<Slot> = into.iter().map(|to| to.slot).collect();
        let places = self.emit.builder.places(&slots);
        self.store(into, |writer| writer.emit.op(Op::Unpack { format, into: places }));
    }

    fn reply(
        &mut self,
        statement: &'h Statement,
        port: Option<PortId>,
        to: &'h Answered,
        values: &'h [Expr],
    ) {
        let fields = |fields: &[Field]| fields.iter().map(|field| field.of).collect();
        let declared = port.map(|port| &self.hir.ports[port.index()]);
        let fields: Vec<Type> = match (declared, to) {
            (Some(port), Answered::Ticket { .. }) => fields(&port.message),
            (Some(port), Answered::Last | Answered::Of(_)) => fields(&port.answer),
            (None, _) => values.iter().map(|value| value.of).collect(),
        };
        let format = self.emit.builder.format(&fields);
        if let Answered::Ticket { asker, number } = to {
            self.emit.op(Op::Term(Term::Push(i64::from(asker.0))));
            self.emit.ops(&number.ops);
        }
        self.values(values);
        self.emit.op(match (to, port) {
            (Answered::Of(task), Some(port)) => Op::ReplyOwed { port, task: *task, format },
            (Answered::Ticket { .. }, Some(port)) => Op::ReplyFor { port, format },
            (Answered::Last, _) | (_, None) => Op::Reply { format },
        });
        self.keep_outcome();
        self.branches(statement, "reply", &[TOO_LATE]);
    }

    /// Emits the storing of an action's result.
    fn result(&mut self, into: Option<Destination>) {
        self.keep_outcome();
        let Some(to) = into else { return };
        let (done, on) = (self.emit.label(), self.emit.label());
        self.emit.on(Outcomes::of(&[StatementOutcome::Done]), done);
        self.emit.jump(on);
        self.emit.put(done);
        self.store(&[to], |writer| {
            writer.emit.op(Op::Value);
            if to.of == Type::Real {
                // A real result comes as the 32 bits of a float. The script reads these bits as unsigned, so 2^32 is added
                // to a negative number.
                let beyond = i64::from(u32::MAX) + 1;
                for term in [
                    Term::Push(beyond),
                    Term::Int(Binary::Add),
                    Term::Push(beyond),
                    Term::Int(Binary::Remainder),
                ] {
                    writer.emit.op(Op::Term(term));
                }
            }
            writer.emit.op(Op::Store(to.slot));
        });
        self.emit.put(on);
    }

    fn values(&mut self, values: &[Expr]) {
        values.iter().for_each(|value| self.emit.ops(&value.ops));
    }

    /// Emits the operations of `write`, which store into these variables. Then emits the start or stop of each silence
    /// timer whose condition reads one of them.
    fn store(&mut self, into: &[Destination], write: impl FnOnce(&mut Self)) {
        let slots: Vec<Slot> = into.iter().map(|to| to.slot).collect();
        let silences = std::mem::take(&mut self.silences);
        let mut emit = std::mem::replace(&mut self.emit, super::emit::Emitter::new(""));
        silence::store(&silences, &mut emit, &slots, |inner| {
            std::mem::swap(&mut self.emit, inner);
            write(self);
            std::mem::swap(&mut self.emit, inner);
        });
        (self.emit, self.silences) = (emit, silences);
    }

    fn message_format(&mut self, port: PortId) -> u16 {
        self.format(&self.hir.ports[port.index()].message)
    }

    fn answer_format(&mut self, port: PortId) -> u16 {
        self.format(&self.hir.ports[port.index()].answer)
    }

    fn format(&mut self, fields: &[Field]) -> u16 {
        let fields: Vec<Type> = fields.iter().map(|field| field.of).collect();
        self.emit.builder.format(&fields)
    }

    fn count(&mut self, n: usize, what: &str) -> u8 {
        u8::try_from(n).unwrap_or_else(|_| {
            self.too_many(what);
            u8::MAX
        })
    }

    fn too_many(&mut self, what: &str) {
        let found = Diagnostic::error(TOO_MANY, self.emit.at, format!("too many {what}"));
        self.errors.push(found.label("split this"));
    }
}
