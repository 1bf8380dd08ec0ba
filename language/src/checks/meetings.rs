//! Checks `waitfor` (§4.3): every member reaches each `waitfor`, all members in one order, and each member can give up.

use super::{is_draft, ring, task, tasks};
use crate::ast::BranchKind;
use crate::codes::{CONDITIONAL, NEVER_COMES, NO_TIME_OUT, WAITFOR_ORDER};
use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Port, StatementKind};
use crate::span::Span;
use crate::walk;
use imrs_protocol::{PortId, TaskId, Usage};

pub(super) fn check(hir: &Hir, paper: bool, found: &mut Vec<Diagnostic>) {
    for (at, port) in hir.ports.iter().enumerate() {
        if port.usage == Usage::Waitfor {
            everybody_comes(hir, PortId::from_index(at), port, found);
            on_no_condition(hir, PortId::from_index(at), port, found);
        }
    }
    in_one_order(hir, found);
    if !paper {
        can_give_up(hir, found);
    }
}

/// The span that names a member of a `waitfor`: in the `user_list`, or at the owner's port.
fn named(port: &Port, member: TaskId) -> Span {
    port.user(member).map_or(port.span, |user| user.listed)
}

fn comes(hir: &Hir, port: PortId, member: TaskId) -> bool {
    let is = |kind: &StatementKind| matches!(kind, StatementKind::Waitfor { port: at, .. } if *at == port);
    task(hir, member).is_extern || walk::any(task(hir, member), |statement| is(&statement.kind))
}

fn everybody_comes(hir: &Hir, id: PortId, port: &Port, found: &mut Vec<Diagnostic>) {
    let (come, missing): (Vec<TaskId>, Vec<TaskId>) =
        port.parties().partition(|&member| comes(hir, id, member));
    let Some(&one) = come.first() else { return };
    for member in missing.into_iter().filter(|&member| !is_draft(task(hir, member))) {
        let (name, waits) = (&task(hir, member).name, &task(hir, one).name);
        let number = port.parties().count();
        let message =
            format!("port `{}` is a {number}-way waitfor, but `{name}` never reaches it", port.name);
        found.push(
            Diagnostic::error(NEVER_COMES, named(port, member), message)
                .label(format!("no `waitfor {}` in `{name}`", port.name))
                .also(task(hir, member).span, format!("`{name}`"))
                .help(format!("`{waits}` would always wait in vain: add it there, or drop `{name}`")),
        );
    }
}

/// Reports members that reach a `waitfor` only under some condition, if another member always reaches it.
fn on_no_condition(hir: &Hir, id: PortId, port: &Port, found: &mut Vec<Diagnostic>) {
    let mut always = Vec::new();
    let mut sometimes = Vec::new();
    for member in port.parties().filter(|&member| !task(hir, member).is_extern) {
        let mut places = Vec::new();
        let mut certain = false;
        let is = |kind: &StatementKind| matches!(kind, StatementKind::Waitfor { port: at, .. } if *at == id);
        walk::of_task(task(hir, member), &mut |at| places.extend(is(&at.kind).then_some(at.span)));
        walk::certain(&task(hir, member).body, &mut |at| certain |= is(&at.kind));
        match places.first() {
            Some(_) if certain => always.push(member),
            Some(&place) => sometimes.push((member, place)),
            None => {}
        }
    }
    let Some(&one) = always.first() else { return };
    for (member, place) in sometimes {
        let (name, other) = (&task(hir, member).name, &task(hir, one).name);
        let message = format!("`{name}` reaches `{}` only under a condition, `{other}` always", port.name);
        found.push(
            Diagnostic::warning(CONDITIONAL, place, message)
                .label("not reached where the condition is false")
                .also(port.span, "the port")
                .help("put the condition behind the `waitfor`, or send it to all members first"),
        );
    }
}

fn can_give_up(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for (_, task) in tasks(hir) {
        walk::of_task(task, &mut |statement| {
            let StatementKind::Waitfor { port, .. } = &statement.kind else { return };
            if statement.branches.iter().any(|branch| branch.when == BranchKind::TimeOut) {
                return;
            }
            let name = &hir.ports[port.index()].name;
            let message = format!("`waitfor {name}` without `on time_out`");
            found.push(
                Diagnostic::error(NO_TIME_OUT, statement.span, message)
                    .label("what if a member does not arrive?")
                    .help("add `on time_out do .. end`"),
            );
        });
    }
}

/// Reports members that reach two `waitfor`s in different orders: these members would wait for each other.
fn in_one_order(hir: &Hir, found: &mut Vec<Diagnostic>) {
    let mut orders: Vec<Order> = Vec::new();
    for (id, task) in tasks(hir).filter(|(_, task)| !is_draft(task)) {
        let mut met: Vec<usize> = Vec::new();
        walk::certain(&task.body, &mut |statement| {
            let StatementKind::Waitfor { port, .. } = &statement.kind else { return };
            let port = port.index();
            if !met.contains(&port) {
                orders.extend(met.iter().map(|&before| ((before, port), id, statement.span)));
                met.push(port);
            }
        });
    }
    let edges: Vec<(usize, usize)> = orders.iter().map(|order| order.0).collect();
    for ring in ring::all(hir.ports.len(), &edges) {
        crossed(hir, &orders, &ring, found);
    }
}

/// Two `waitfor`s (by port) in the order in which a task reaches them, that task, and the span of its later wait.
type Order = ((usize, usize), TaskId, Span);

fn crossed(hir: &Hir, orders: &[Order], ring: &[usize], found: &mut Vec<Diagnostic>) {
    let steps = ring.iter().zip(ring.iter().cycle().skip(1));
    let steps: Vec<_> = steps.filter_map(|(&a, &b)| orders.iter().find(|order| order.0 == (a, b))).collect();
    let said = steps.iter().map(|((a, b), id, _)| {
        format!("`{}` does `{}` before `{}`", task(hir, *id).name, hir.ports[*a].name, hir.ports[*b].name)
    });
    let message = format!("waitfor order differs: {}", said.collect::<Vec<_>>().join(", "));
    let Some((last, first)) = steps.split_last() else { return };
    let report = Diagnostic::error(WAITFOR_ORDER, last.2, message).label("here it waits for the others");
    let report = first.iter().fold(report, |report, step| report.also(step.2, "while they wait here"));
    found.push(report.help("let all members reach them in one order"));
}
