//! Every message that waits for an answer gets one, whichever way a handler goes.

use super::flow;
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
            let ever = replies(&handler.body);
            let ends = Ways::of(&handler.body, Ways::OPEN);
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
            } else if ends.next.open {
                let message =
                    format!("a message of `{name}` is not answered on every way through its handler");
                found.push(
                    Diagnostic::warning(NOT_ALWAYS_ANSWERED, handler.span, message)
                        .label(format!("may end without `{word}(..)`"))
                        .help("answer on every way, or the sender waits until its time_out"),
                );
            }
        }
        received_in_body(hir, TaskId::from_index(at), found);
        for handler in &task.handlers {
            unasked(hir, &handler.captures, &[&handler.body], |slot| variable(&handler.locals, slot), found);
        }
        let bodies = [Some(&task.body), task.takeover.as_ref()].into_iter().flatten().collect::<Vec<_>>();
        unasked(hir, &task.captures, &bodies, |slot| variable(&task.variables, slot), found);
    }
}

/// Where a slot's variable stands.
fn variable(variables: &[Variable], slot: Slot) -> Option<Span> {
    let (Slot::Task(at) | Slot::Local(at)) = slot;
    variables.get(usize::from(at)).map(|variable| variable.span)
}

/// `p.x(t)` and its like hear what the statements of their own thread brought (D93): without such a statement nothing.
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
                .label("no statement of this body or handler asks or meets there")
                .also(port.span, "the port")
                .help("keep what was told in a variable, where it was heard, and look at that"),
        );
    }
}

/// What a body receives of class 2 must be answered somewhere in it.
fn received_in_body(hir: &Hir, id: TaskId, found: &mut Vec<Diagnostic>) {
    let task = &hir.tasks[id.index()];
    for body in [Some(&task.body), task.takeover.as_ref()].into_iter().flatten() {
        let answered = replies(body);
        walk::each(body, &mut |statement| {
            let StatementKind::Receive { port: Some(taken), .. } = statement.kind else { return };
            let port = &hir.ports[taken.index()];
            if answered
                || answers_later(task, taken)
                || port.class == Class::Status
                || answered_by_others(hir, id, port)
            {
                return;
            }
            let message = format!("a message of `{}` is never answered", port.name);
            found.push(
                Diagnostic::error(NEVER_ANSWERED, statement.span, message)
                    .label("no `reply(..)` follows")
                    .also(port.span, "class 2: its sender waits for the answer")
                    .help("add `reply(..)` behind it"),
            );
        });
    }
}

/// Whether the task answers messages of the port some time after it took them.
pub(super) fn answers_later(task: &Task, id: PortId) -> bool {
    walk::any(
        task,
        |statement| matches!(&statement.kind, StatementKind::Reply { port, to: Answered::Of(_), .. } if *port == Some(id)),
    )
}

/// Whether it is an answer itself, or a port of usage `reply` may carry that of somebody else (D11).
pub(super) fn answered_by_others(hir: &Hir, at: TaskId, port: &Port) -> bool {
    if port.usage == Usage::Reply {
        return true;
    }
    let asks = |task: TaskId| port.peers(at).any(|peer| peer == task);
    hir.ports
        .iter()
        .any(|other| other.usage == Usage::Reply && other.users.iter().any(|user| asks(user.task)))
}

fn replies(body: &[Statement]) -> bool {
    let mut has = false;
    walk::each(body, &mut |statement| {
        has |= matches!(statement.kind, StatementKind::Reply { to: Answered::Last, .. });
    });
    has
}

/// In which state a point may be reached: with the message still open, or answered.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Reached {
    open: bool,
    answered: bool,
}

impl Reached {
    fn or(self, other: Self) -> Self {
        Self { open: self.open || other.open, answered: self.answered || other.answered }
    }
}

/// How statements are left: at their end, or by `exit`.
#[derive(Clone, Copy, Default)]
struct Ways {
    next: Reached,
    exit: Reached,
}

impl Ways {
    const OPEN: Reached = Reached { open: true, answered: false };

    fn of(statements: &[Statement], from: Reached) -> Self {
        let mut ways = Self { next: from, exit: Reached::default() };
        for statement in statements {
            let step = Self::through(statement, ways.next);
            ways = Self { next: step.next, exit: ways.exit.or(step.exit) };
        }
        ways
    }

    fn through(statement: &Statement, from: Reached) -> Self {
        let plain = |next| Self { next, exit: Reached::default() };
        let mut ways = match &statement.kind {
            StatementKind::Reply { to: Answered::Last, .. } => {
                plain(Reached { open: false, answered: from.open || from.answered })
            }
            StatementKind::Abort(_) => plain(Reached::default()),
            StatementKind::Exit => Self { next: Reached::default(), exit: from },
            StatementKind::Atomic(body) => Self::of(body, from),
            StatementKind::Loop(body) => {
                let once = Self::of(body, from);
                let head = from.or(once.next);
                // Loops in loops would be gone through too often.
                let again = if head == from { once } else { Self::of(body, head) };
                plain(once.exit.or(again.exit))
            }
            StatementKind::While(condition, body) => {
                let once = Self::of(body, from);
                let left = if flow::is_true(condition) { Reached::default() } else { from.or(once.next) };
                plain(left.or(once.exit))
            }
            StatementKind::If { arms, otherwise } => {
                let arms = arms.iter().map(|(_, body)| Self::of(body, from));
                arms.fold(Self::of(otherwise, from), |a, b| Self {
                    next: a.next.or(b.next),
                    exit: a.exit.or(b.exit),
                })
            }
            _ => plain(from),
        };
        for branch in &statement.branches {
            let other = Self::of(&branch.body, from);
            ways = Self { next: ways.next.or(other.next), exit: ways.exit.or(other.exit) };
        }
        ways
    }
}
