//! Checks what each process class requires (D24).

use super::{is_draft, messages, task};
use crate::codes::{ACTS_EARLY, LOOSE, SERIAL, STANDBY_ENDS, TELLS_NOBODY, TIGHT};
use crate::diagnostic::Diagnostic;
use crate::hir::{Couple, CoupleKind, Hir, Port, StatementKind};
use crate::span::Span;
use crate::walk;
use imrs_protocol::{Class, PortId, TaskId, Usage};

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for couple in &hir.couples {
        match &couple.kind {
            CoupleKind::Tight(tasks) => tight(hir, couple, tasks, found),
            CoupleKind::Serial(first, second) => serial(hir, couple, [*first, *second], found),
            CoupleKind::Loose { tasks, over } => loose(hir, couple, tasks, *over, found),
            CoupleKind::Work { primary, standby, mutual, .. } => {
                waits(hir, couple, *standby, found);
                ends(hir, couple, [*primary, *standby], found);
                if !mutual {
                    heartbeats(hir, couple, [*primary, *standby], found);
                }
            }
        }
    }
}

fn joins(port: &Port, a: TaskId, b: TaskId) -> bool {
    port.usage_of(a).is_some() && port.peers(a).any(|peer| peer == b)
}

/// The tasks of `among` that are connected to `from` by ports for which `like` is true, directly or through other
/// tasks.
fn reached(hir: &Hir, from: TaskId, among: &[TaskId], like: impl Fn(&Port) -> bool) -> Vec<TaskId> {
    let mut known = vec![from];
    let mut at = 0;
    while let Some(&task) = known.get(at) {
        for port in hir.ports.iter().filter(|port| like(port)) {
            for &other in among {
                if !known.contains(&other) && joins(port, task, other) {
                    known.push(other);
                }
            }
        }
        at += 1;
    }
    known
}

/// Reports values that a program publishes although no heartbeat carries them. In a one-way couple only the primary's
/// answers carry values, and only the standby reads them (D61, D78).
fn heartbeats(hir: &Hir, couple: &Couple, [primary, standby]: [TaskId; 2], found: &mut Vec<Diagnostic>) {
    let (from, to) = (&task(hir, primary).name, &task(hir, standby).name);
    let mut say = |span, message: String, label: &str| {
        found.push(
            Diagnostic::warning(TELLS_NOBODY, span, message)
                .label(label)
                .also(couple.span, format!("`{from}` answers the heartbeats, `{to}` only asks"))
                .help("write `<->` if they change roles, or remove this"),
        );
    };
    walk::of_task(task(hir, standby), &mut |statement| {
        if matches!(statement.kind, StatementKind::Publish { .. }) {
            say(statement.span, format!("no task reads what `{to}` publishes"), "no heartbeat carries it");
        }
    });
    walk::of_task(task(hir, primary), &mut |statement| {
        if matches!(statement.kind, StatementKind::Published { .. }) {
            say(
                statement.span,
                format!("`{to}` publishes nothing to `{from}`"),
                "no value ever arrives here",
            );
        }
    });
}

/// Checks that ports of usage query or response connect all members of a `tight` couple.
fn tight(hir: &Hir, couple: &Couple, tasks: &[TaskId], found: &mut Vec<Diagnostic>) {
    let Some(&first) = tasks.first() else { return };
    let known = reached(hir, first, tasks, |port| matches!(port.usage, Usage::Query | Usage::Response));
    if let Some(&other) = tasks.iter().find(|task| !known.contains(task)) {
        let (a, b) = (&task(hir, first).name, &task(hir, other).name);
        let message = format!("`{a}` and `{b}` are tightly coupled, but no query joins them");
        found.push(
            Diagnostic::warning(TIGHT, couple.span, message)
                .label("a tight couple answers each other (Table 1)")
                .help("add a port of usage query or response between them, or another class"),
        );
    }
}

/// Checks that the second task of a `serial` couple waits for the first task, by a `waitfor` or by class-2 messages.
fn serial(hir: &Hir, couple: &Couple, [first, second]: [TaskId; 2], found: &mut Vec<Diagnostic>) {
    let all: Vec<TaskId> = (0..hir.tasks.len()).map(TaskId::from_index).collect();
    if reached(hir, first, &all, |port| port.class == Class::Command).contains(&second) {
        return;
    }
    let (a, b) = (&task(hir, first).name, &task(hir, second).name);
    found.push(
        Diagnostic::warning(SERIAL, couple.span, format!("nothing orders `{a}` before `{b}`"))
            .label("neither a `waitfor` nor a class-2 message between them")
            .help(format!("add a `waitfor` of both, or a class-2 message from `{a}` to `{b}`")),
    );
}

/// Checks that the members of a `loose` couple use the administrator's ports, and that no `receive` waits for the
/// administrator without end.
fn loose(hir: &Hir, couple: &Couple, tasks: &[TaskId], over: TaskId, found: &mut Vec<Diagnostic>) {
    let owner = task(hir, over);
    for &member in tasks.iter().filter(|&&member| member != over) {
        if !hir.ports.iter().any(|port| port.owner == over && joins(port, over, member)) {
            let name = &task(hir, member).name;
            let message =
                format!("`{name}` shares what `{}` administers, but uses no port of it", owner.name);
            found.push(
                Diagnostic::warning(LOOSE, couple.span, message)
                    .label("the administrator owns the ports")
                    .also(owner.span, "the administrator")
                    .help("let it own a port that the others use, and ask it through that"),
            );
        }
        for (port, place) in waits_for_ever(hir, member, over) {
            let name = &hir.ports[port.index()].name;
            let message = format!("`receive {name}` waits for `{}` without end", owner.name);
            found.push(
                Diagnostic::warning(LOOSE, place, message)
                    .label("a loose couple goes on without its administrator")
                    .also(couple.span, "the couple")
                    .help("add `within ..`"),
            );
        }
    }
}

fn waits_for_ever(hir: &Hir, member: TaskId, over: TaskId) -> Vec<(PortId, Span)> {
    let mut places = Vec::new();
    walk::of_task(task(hir, member), &mut |statement| {
        if let StatementKind::Receive { port: Some(port), within: None, .. } = statement.kind {
            let declared = &hir.ports[port.index()];
            let own = declared.user(member).and_then(|user| user.time_out);
            if own.is_none() && joins(declared, member, over) {
                places.push((port, statement.span));
            }
        }
    });
    places
}

/// Checks that the standby of a `work` couple runs no action before it takes over (D61).
fn waits(hir: &Hir, couple: &Couple, standby: TaskId, found: &mut Vec<Diagnostic>) {
    let standby = task(hir, standby);
    if is_draft(standby) {
        return;
    }
    walk::each(&standby.body, &mut |statement| {
        if let StatementKind::Run { action, .. } = &statement.kind {
            let message = format!("`{}` acts before it takes over: `run {action}`", standby.name);
            found.push(
                Diagnostic::error(ACTS_EARLY, statement.span, message)
                    .label("without the lease")
                    .also(couple.span, "its couple")
                    .help("put it behind `takeover`"),
            );
        }
    });
}

/// Checks that a standby does not end before it takes over: after its end no task can grant the lease.
fn ends(hir: &Hir, couple: &Couple, [primary, standby]: [TaskId; 2], found: &mut Vec<Diagnostic>) {
    let (primary, standby) = (task(hir, primary), task(hir, standby));
    if standby.is_extern || is_draft(standby) || walk::only_serves(standby) || !walk::all_go_on(&standby.body)
    {
        return;
    }
    let message = format!("the body of `{}` ends: then `{}` loses its lease", standby.name, primary.name);
    found.push(
        Diagnostic::warning(STANDBY_ENDS, standby.span, message)
            .label("its body ends without an endless `loop`")
            .also(couple.span, "its couple")
            .help("let it wait in a loop: `loop delay 1 sec; end;`"),
    );
}

/// Whether tasks use the port in statements. A port that only carries heartbeats is not used by tasks: the communication
/// tasks exchange heartbeats.
pub(super) fn is_used_by_tasks(hir: &Hir, id: PortId) -> bool {
    !messages::carries_heartbeats(hir, id)
}
