//! Checks that every received message that waits for an answer gets one, on every path of the handler or body that received
//! it.

use super::unanswered::{self, Question};
use crate::codes::{NEVER_ANSWERED, NOT_ALWAYS_ANSWERED, STATEMENT};
use crate::diagnostic::Diagnostic;
use crate::hir::{Answered, Capture, Captured, Hir, Port, Statement, StatementKind, Task, Trigger, Variable};
use crate::span::Span;
use crate::walk;
use imrs_protocol::script::Slot;
use imrs_protocol::{Class, PortId, TaskId, Usage};

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for (at, task) in hir.tasks.iter().enumerate() {
        for handler in &task.handlers {
            let Trigger::Message(id) = handler.trigger else { continue };
            let port = &hir.ports[id.index()];
            if port.class == Class::Status
                || answered_by_others(hir, TaskId::from_index(at), port)
                || answers_later(task, id)
            {
                continue;
            }
            let ever = unanswered::replies(&handler.body);
            let query = port.usage_of(TaskId::from_index(at)) == Some(Usage::Response);
            let word = if query { "response" } else { "reply" };
            let name = &port.name;
            if !ever {
                let message = format!("a message of `{name}` is never answered");
                found.push(
                    Diagnostic::error(NEVER_ANSWERED, handler.span, message)
                        .label(format!("no `{word}(..)` in this handler"))
                        .also(port.span, "class 2: its sender waits for the answer")
                        .help(format!("add `{word}(..)`")),
                );
            } else if unanswered::forgets(&handler.body, &handler.captures, Question::OfHandler) {
                let message =
                    format!("a message of `{name}` is not answered on every path through its handler");
                found.push(
                    Diagnostic::warning(NOT_ALWAYS_ANSWERED, handler.span, message)
                        .label(format!("may end without `{word}(..)`"))
                        .help("answer on every path, or the sender waits until its time_out"),
                );
            }
        }
        received(hir, TaskId::from_index(at), found);
        for handler in &task.handlers {
            unasked(hir, &handler.captures, &[&handler.body], |slot| variable(&handler.locals, slot), found);
        }
        let bodies = [Some(&task.body), task.takeover.as_ref()].into_iter().flatten().collect::<Vec<_>>();
        unasked(hir, &task.captures, &bodies, |slot| variable(&task.variables, slot), found);
    }
}

/// The span of the variable at a slot.
fn variable(variables: &[Variable], slot: Slot) -> Option<Span> {
    let (Slot::Task(at) | Slot::Local(at)) = slot;
    variables.get(usize::from(at)).map(|variable| variable.span)
}

/// Reports an expression such as `p.x(t)` if no statement of its thread can set the value (D93).
fn unasked(
    hir: &Hir,
    captures: &[Capture],
    bodies: &[&Vec<Statement>],
    place: impl Fn(Slot) -> Option<Span>,
    found: &mut Vec<Diagnostic>,
) {
    for capture in captures {
        let (Captured::Told(id, _) | Captured::Answered(id, _) | Captured::Refused(id, _)) = capture.what
        else {
            continue;
        };
        let mut asks = false;
        for body in bodies {
            walk::each(body, &mut |statement| {
                asks |= match statement.kind {
                    StatementKind::Send { port, .. } | StatementKind::Waitfor { port, .. } => port == id,
                    _ => false,
                };
            });
        }
        let Some(span) = place(capture.slot).filter(|_| !asks) else { continue };
        let port = &hir.ports[id.index()];
        let message = format!("nothing is known of `{}` here", port.name);
        found.push(
            Diagnostic::error(STATEMENT, span, message)
                .label("no statement of this body or handler asks or waits there")
                .also(port.span, "the port")
                .help("keep the value in a variable where it arrives, and read that variable"),
        );
    }
}

/// Reports received class-2 messages that a thread does not answer, or not on every path from the `receive`.
fn received(hir: &Hir, id: TaskId, found: &mut Vec<Diagnostic>) {
    let task = &hir.tasks[id.index()];
    let bodies = [Some(&task.body), task.takeover.as_ref()].into_iter().flatten();
    let bodies = bodies.map(|body| (body, &task.captures));
    let handlers = task.handlers.iter().map(|handler| (&handler.body, &handler.captures));
    for (body, captures) in bodies.chain(handlers) {
        let answered = unanswered::replies(body);
        walk::each(body, &mut |statement| {
            let StatementKind::Receive { port: Some(taken), .. } = statement.kind else { return };
            let port = &hir.ports[taken.index()];
            if answers_later(task, taken) || port.class == Class::Status || answered_by_others(hir, id, port)
            {
                return;
            }
            let word = if port.usage_of(id) == Some(Usage::Response) { "response" } else { "reply" };
            let name = &port.name;
            if !answered {
                let message = format!("a message of `{name}` is never answered");
                found.push(
                    Diagnostic::error(NEVER_ANSWERED, statement.span, message)
                        .label(format!("no `{word}(..)` follows"))
                        .also(port.span, "class 2: its sender waits for the answer")
                        .help(format!("add `{word}(..)` behind it")),
                );
            } else if unanswered::forgets(body, captures, Question::Of(statement, taken)) {
                let message = format!("a message of `{name}` is not answered on every path");
                let help = format!(
                    "write `{word}(..)` on every path, before the next `receive`, or the sender waits until its time_out"
                );
                found.push(
                    Diagnostic::warning(NOT_ALWAYS_ANSWERED, statement.span, message)
                        .label(format!("a path from here reaches no `{word}(..)`"))
                        .also(port.span, "class 2: its sender waits for the answer")
                        .help(help),
                );
            }
        });
    }
}

/// Whether the task answers messages of the port later: by `reply .. for`.
pub(super) fn answers_later(task: &Task, id: PortId) -> bool {
    walk::any(
        task,
        |statement| matches!(&statement.kind, StatementKind::Reply { port, to: Answered::Of(_), .. } if *port == Some(id)),
    )
}

/// Whether the message needs no answer from this task: the message is an answer itself, or a port of usage `reply` may
/// carry the answer (D11).
pub(super) fn answered_by_others(hir: &Hir, at: TaskId, port: &Port) -> bool {
    if port.usage == Usage::Reply {
        return true;
    }
    let asks = |task: TaskId| port.peers(at).any(|peer| peer == task);
    hir.ports
        .iter()
        .any(|other| other.usage == Usage::Reply && other.users.iter().any(|user| asks(user.task)))
}
