//! Checks messages: a task must receive each message, no tasks may ask each other in a ring, and each request should have a
//! branch for a bad outcome.

use super::{is_draft, ring, task, tasks, time};
use crate::ast::BranchKind;
use crate::codes::{
    FULL, LITERAL_PENALTY, LONG_PENALTY, NEVER_RECEIVED, NOBODY_LISTENS, RING, TOO_BUSY, UNPREPARED,
};
use crate::diagnostic::Diagnostic;
use crate::hir::{Answered, CoupleKind, Hir, Port, Recipients, Statement, StatementKind, Task, Trigger};
use crate::walk;
use imrs_protocol::{Class, PortId, TaskId, Usage};

pub(super) fn check(hir: &Hir, paper: bool, found: &mut Vec<Diagnostic>) {
    for (at, port) in hir.ports.iter().enumerate() {
        let id = PortId::from_index(at);
        // A message of usage `reply` ends a query (D11): no statement receives it.
        if !matches!(port.usage, Usage::Waitfor | Usage::Reply) && !carries_heartbeats(hir, id) {
            is_received(hir, id, port, found);
            has_room(hir, port, found);
            has_time(hir, id, port, found);
        }
        penalty(port, paper, found);
    }
    rings(hir, found);
    for (id, task) in tasks(hir) {
        walk::of_task(task, &mut |statement| unprepared(hir, id, statement, found));
    }
}

/// Whether the port carries heartbeats, which the communication tasks exchange (D61).
pub(crate) fn carries_heartbeats(hir: &Hir, id: PortId) -> bool {
    hir.couples.iter().any(|couple| matches!(couple.kind, CoupleKind::Work { via, .. } if via == id))
}

pub(super) fn senders(port: &Port) -> impl Iterator<Item = TaskId> + '_ {
    let sends = |usage| matches!(usage, Some(Usage::Send | Usage::Query | Usage::Reply));
    port.parties().filter(move |&task| sends(port.usage_of(task)))
}

/// The tasks that use the port by themselves: the senders, or all members of a `waitfor`.
pub(crate) fn starters(port: &Port) -> Vec<TaskId> {
    if port.usage == Usage::Waitfor { port.parties().collect() } else { senders(port).collect() }
}

fn receivers(port: &Port) -> impl Iterator<Item = TaskId> + '_ {
    let receives = |usage| matches!(usage, Some(Usage::Receive | Usage::Response));
    port.parties().filter(move |&task| receives(port.usage_of(task)))
}

/// The first statement of `from` that sends through the port. If `to` is given, the statement must send to that task.
fn sending(hir: &Hir, id: PortId, from: TaskId, to: Option<TaskId>) -> Option<&Statement> {
    let mut first = None;
    walk::of_task(task(hir, from), &mut |statement| {
        let sends = match &statement.kind {
            StatementKind::Send { port, to: recipients, .. } => {
                let reaches = match (recipients, to) {
                    (Recipients::These(tasks), Some(to)) => tasks.contains(&to),
                    (Recipients::These(_) | Recipients::All, _) => true,
                };
                *port == id && reaches
            }
            StatementKind::Reply { port, to: Answered::Ticket { .. }, .. } => *port == Some(id),
            _ => false,
        };
        if sends && first.is_none() {
            first = Some(statement);
        }
    });
    first
}

/// Whether `from` may ever send to `to` through the port.
pub(super) fn sends_to(hir: &Hir, id: PortId, from: TaskId, to: TaskId) -> bool {
    task(hir, from).is_extern || sending(hir, id, from, Some(to)).is_some()
}

pub(super) fn is_sent(hir: &Hir, id: PortId, from: TaskId) -> bool {
    task(hir, from).is_extern || sending(hir, id, from, None).is_some()
}

pub(super) fn has_handler(task: &Task, id: PortId) -> bool {
    task.handlers.iter().any(|handler| matches!(handler.trigger, Trigger::Message(port) if port == id))
}

fn takes(task: &Task, id: PortId) -> bool {
    let receives = |statement: &Statement| match statement.kind {
        StatementKind::Receive { port, .. } => port.is_none_or(|port| port == id),
        _ => false,
    };
    task.is_extern || has_handler(task, id) || walk::any(task, receives)
}

fn is_received(hir: &Hir, id: PortId, port: &Port, found: &mut Vec<Diagnostic>) {
    let misses = |task: &Task| !is_draft(task) && !takes(task, id);
    for receiver in receivers(port).filter(|&receiver| misses(task(hir, receiver))) {
        let sent = senders(port).find_map(|from| Some((from, sending(hir, id, from, Some(receiver))?)));
        let Some((from, sent)) = sent else { continue };
        let (name, sender) = (&task(hir, receiver).name, &task(hir, from).name);
        let place = port.user(receiver).and_then(|user| user.span).unwrap_or(port.span);
        let (word, help) = match port.usage_of(receiver) {
            Some(Usage::Response) => ("on query", "`on query"),
            _ => ("on receive", "`on receive"),
        };
        let message = format!("`{name}` never takes the messages of `{}`", port.name);
        let report = match port.class {
            Class::Command => Diagnostic::error(NEVER_RECEIVED, place, message),
            Class::Status => Diagnostic::warning(NOBODY_LISTENS, place, message),
        };
        found.push(
            report
                .label(format!("neither `{word} {}` nor a `receive` in `{name}`", port.name))
                .also(sent.span, format!("`{sender}` sends here"))
                .help(format!("add {help} {}(..) do .. end` to `{name}`", port.name)),
        );
    }
}

/// Reports a buffer smaller than the number of senders of class-2 messages, because such a buffer may refuse a message
/// (D21). Of the two tasks of a couple, only one sends at a time.
fn has_room(hir: &Hir, port: &Port, found: &mut Vec<Diagnostic>) {
    let number = senders(port).filter(|&from| !is_draft(task(hir, from))).count();
    let commands = port.class == Class::Command && port.usage == Usage::Receive;
    if !commands || port.guard.is_some() || number <= usize::from(port.bounded_buffer) {
        return;
    }
    let room = port.bounded_buffer;
    let message =
        format!("bounded_buffer[{room}] of `{}` with {number} senders may refuse messages", port.name);
    found.push(
        Diagnostic::warning(FULL, port.buffer_span.unwrap_or(port.span), message)
            .label(if port.buffer_span.is_some() { "too small" } else { "bounded_buffer[1] by default" })
            .help(format!("write `bounded_buffer[{number}]`: one place for each sender")),
    );
}

/// Reports a `run` or `delay` during which a class-2 message may expire. A `receive` takes the message only after that
/// work. A message for a handler is offered again until the handler interrupts the work (D58), but `atomic` prevents
/// that.
fn has_time(hir: &Hir, id: PortId, port: &Port, found: &mut Vec<Diagnostic>) {
    if port.class != Class::Command {
        return;
    }
    for receiver in receivers(port) {
        let task = task(hir, receiver);
        let ttls = senders(port)
            .filter_map(|from| port.user(from).and_then(|user| user.time_out).or(port.time_out))
            .map(|ttl| ttl.usec);
        let (Some(ttl), false) = (ttls.min(), task.is_extern) else { continue };
        let by_handler = has_handler(task, id);
        if !by_handler && !takes(task, id) {
            continue;
        }
        let longest = longest(task, by_handler);
        let Some((what, length, place)) = longest.filter(|&(_, length, _)| length > ttl) else { continue };
        let message = format!(
            "`{}` needs its answer in {}, but {what} takes up to {}",
            port.name,
            time(ttl),
            time(length)
        );
        let (label, help) = if by_handler {
            ("no handler interrupts it: it is `atomic`", "end the `atomic` in front of it".to_owned())
        } else {
            (
                "no message is taken meanwhile",
                format!("take `{}` with a handler, or raise its time_out", port.name),
            )
        };
        let report = Diagnostic::warning(TOO_BUSY, place, message).label(label).also(port.span, "the port");
        found.push(report.help(help));
    }
}

/// The longest `run` or `delay` of the body, or of its atomic sections.
fn longest(task: &Task, in_atomic: bool) -> Option<(String, u64, crate::Span)> {
    let mut longest: Option<(String, u64, crate::Span)> = None;
    let mut see = |statement: &Statement| {
        let (what, length) = match &statement.kind {
            StatementKind::Run { action, takes, .. } => (format!("`run {action}`"), takes.1.usec),
            StatementKind::Delay(length) => ("the `delay`".to_owned(), length.usec),
            _ => return,
        };
        if longest.as_ref().is_none_or(|&(_, most, _)| most < length) {
            longest = Some((what, length, statement.span));
        }
    };
    walk::each(&task.body, &mut |statement| match &statement.kind {
        StatementKind::Atomic(body) if in_atomic => walk::each(body, &mut see),
        _ if !in_atomic => see(statement),
        _ => {}
    });
    longest
}

fn penalty(port: &Port, paper: bool, found: &mut Vec<Diagnostic>) {
    let (Some((length, literal)), Some(ttl)) = (port.penalty, port.time_out) else { return };
    if literal && !paper {
        let message =
            format!("`penalty = paper` of `{}` extends the remaining time of rejected messages", port.name);
        found.push(
            Diagnostic::warning(LITERAL_PENALTY, length.span, message)
                .label(format!(
                    "each rejection adds {} to a time_out of {}",
                    time(length.usec),
                    time(ttl.usec)
                ))
                .help(format!(
                    "write `penalty = {}`: rejected messages then rise in rank (D4)",
                    time(length.usec)
                )),
        );
    } else if length.usec >= ttl.usec && !literal {
        let (penalty, ttl) = (time(length.usec), time(ttl.usec));
        let message = format!("penalty {penalty} x 1 rejection >= time_out {ttl} of `{}`", port.name);
        found.push(
            Diagnostic::warning(LONG_PENALTY, length.span, message)
                .label("longer than the time_out: it is cut to half of the remaining time")
                .help("write a penalty of a few ticks, far below the time_out"),
        );
    }
}

/// Reports tasks that ask each other in a ring: none of them can answer while it waits.
fn rings(hir: &Hir, found: &mut Vec<Diagnostic>) {
    let mut calls: Vec<Call> = Vec::new();
    for (at, port) in hir.ports.iter().enumerate().filter(|(_, port)| port.class == Class::Command) {
        let id = PortId::from_index(at);
        for from in senders(port).filter(|_| !carries_heartbeats(hir, id)) {
            for to in receivers(port) {
                if let Some(place) = certain_call(hir, id, from, to)
                    && !has_handler(task(hir, to), id)
                    && calls_first(task(hir, to), id)
                {
                    calls.push((from, to, id, place));
                }
            }
        }
    }
    let edges: Vec<(usize, usize)> = calls.iter().map(|call| (call.0.index(), call.1.index())).collect();
    for ring in ring::all(hir.tasks.len(), &edges) {
        asking(hir, &calls, &ring, found);
    }
}

/// A request that a task makes on every path: its sender, its receiver, the port and the span.
type Call = (TaskId, TaskId, PortId, crate::Span);

fn asking(hir: &Hir, calls: &[Call], ring: &[usize], found: &mut Vec<Diagnostic>) {
    let steps = ring.iter().zip(ring.iter().cycle().skip(1));
    let steps: Vec<_> = steps
        .filter_map(|(&a, &b)| calls.iter().find(|call| (call.0.index(), call.1.index()) == (a, b)))
        .collect();
    let Some((first, others)) = steps.split_first() else { return };
    let mut text = format!("`{}`", task(hir, first.0).name);
    for (_, to, port, _) in &steps {
        text.push_str(&format!(" -{}-> `{}`", hir.ports[port.index()].name, task(hir, *to).name));
    }
    let report = Diagnostic::error(RING, first.3, format!("ring of blocking calls: {text}"))
        .label("waits for an answer that no task gives while all ask");
    let report = others.iter().fold(report, |report, call| report.also(call.3, "waits, too"));
    found.push(report.help("answer with a handler (`on query ..`): it runs while its task waits"));
}

/// The statement with which a task asks another task on every path.
fn certain_call(hir: &Hir, id: PortId, from: TaskId, to: TaskId) -> Option<crate::Span> {
    let mut place = None;
    walk::certain(&task(hir, from).body, &mut |statement| {
        if let StatementKind::Send { port, to: recipients, .. } = &statement.kind
            && *port == id
            && (*recipients == Recipients::All
                || matches!(recipients, Recipients::These(tasks) if tasks.contains(&to)))
        {
            place = place.or(Some(statement.span));
        }
    });
    place
}

/// Whether a task asks another task before it receives from this port.
fn calls_first(task: &Task, id: PortId) -> bool {
    let mut first = None;
    walk::each(&task.body, &mut |statement| {
        let asks = match statement.kind {
            StatementKind::Send { .. } => true,
            StatementKind::Receive { port, .. } if port.is_none_or(|port| port == id) => false,
            _ => return,
        };
        first = first.or(Some(asks));
    });
    first == Some(true)
}

/// Reports a request without `on time_out`: the task ends if no answer comes.
fn unprepared(hir: &Hir, id: TaskId, statement: &Statement, found: &mut Vec<Diagnostic>) {
    let StatementKind::Send { port, .. } = &statement.kind else { return };
    let port = &hir.ports[port.index()];
    let prepared = statement.branches.iter().any(|branch| branch.when == BranchKind::TimeOut);
    if port.class == Class::Status || prepared {
        return;
    }
    let what = if port.usage_of(id) == Some(Usage::Query) { "query" } else { "class-2 send" };
    let message = format!("{what} `{}` without `on time_out`: the task ends if no answer comes", port.name);
    found.push(
        Diagnostic::warning(UNPREPARED, statement.span, message)
            .label("no branch")
            .help("add `on time_out do .. end`; `abort` says that the end is meant"),
    );
}
