//! Reports handlers in a task that has no `order`: in such a task `self` ranks first, which is seldom meant (D46, D58,
//! D93).

use super::carries_heartbeats;
use crate::codes::UNRANKED;
use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Statement, StatementKind, Task, Trigger};
use crate::walk;
use imrs_protocol::{Class, PortId, Usage};

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for task in &hir.tasks {
        if walk::any(task, |statement| matches!(statement.kind, StatementKind::Order(_))) {
            continue;
        }
        let handled = task.handlers.iter().find_map(|handler| match handler.trigger {
            Trigger::Message(port) if is_offered(hir, port) => Some((handler.span, port)),
            Trigger::Message(_) | Trigger::Silence { .. } | Trigger::Expiry(_) | Trigger::Fence => None,
        });
        let (Some((head, port)), Some(busy)) = (handled, busy(hir, task)) else { continue };
        found.push(note(hir, task, port, (head, busy)));
    }
}

/// Whether messages of this port are offered to handlers.
fn is_offered(hir: &Hir, port: PortId) -> bool {
    hir.ports[port.index()].usage != Usage::Reply && !carries_heartbeats(hir, port)
}

/// The first statement during which the thread has its own rank: a statement that waits, but is no `receive`.
fn busy<'h>(hir: &Hir, task: &'h Task) -> Option<&'h Statement> {
    let mut first = None;
    for body in [Some(&task.body), task.takeover.as_ref()].into_iter().flatten() {
        walk::each(body, &mut |statement| {
            let waits = match &statement.kind {
                StatementKind::Run { takes, .. } => takes.1.usec > 0,
                StatementKind::Delay(_) | StatementKind::Waitfor { .. } => true,
                StatementKind::Send { port, .. } => hir.ports[port.index()].class == Class::Command,
                _ => false,
            };
            first = first.or(waits.then_some(statement));
        });
    }
    first
}

fn note(hir: &Hir, task: &Task, port: PortId, at: (crate::Span, &Statement)) -> Diagnostic {
    let (head, busy) = at;
    let name = &hir.ports[port.index()].name;
    let message = format!("`{}` has no `order`: its handlers rank behind the task itself", task.name);
    let how = if hir.paper {
        "its messages wait until this is over, whatever their time_out"
    } else {
        "its messages are rejected once before its handler interrupts this"
    };
    Diagnostic::note(UNRANKED, head, message)
        .label(format!("behind `self`, as `order self > {name}` says"))
        .also(busy.span, how)
        .help(format!(
            "begin the body with `order {name} > self;`, or with `order self > {name};` if that is meant"
        ))
}
