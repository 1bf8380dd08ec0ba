//! Lowers the declarations of a cell.

use super::units::Clock;
use crate::hir::{CoupleKind, Field, Hir, Port};
use crate::resolve::word;
use imrs_protocol::cell::{LinkDecl, NodeDecl, TaskDecl, UserDecl};
use imrs_protocol::script::Format;
use imrs_protocol::{Cell, CoupleDecl, Penalty, PortDecl, PortId, Rate, Rules, Ticks, Usage};
use std::fmt::Write;

pub(super) fn cell(hir: &Hir, clock: &mut Clock) -> Cell {
    let tick = hir.tick.map_or(Ticks(1), |tick| clock.bound(tick));
    let nodes = hir.nodes.iter().map(|node| NodeDecl { name: node.name.clone() }).collect();
    let links =
        hir.links.iter().map(|link| LinkDecl { a: link.a, b: link.b, delay: clock.bound(link.delay) });
    let links = links.collect();
    let tasks = hir.tasks.iter().map(|task| TaskDecl {
        name: task.name.clone(),
        node: task.node,
        module: task.module.clone(),
    });
    let tasks = tasks.collect();
    let heartbeats: Vec<PortId> = hir.couples.iter().filter_map(|couple| via(&couple.kind)).collect();
    let ports = hir.ports.iter().enumerate().map(|(at, port)| {
        let is_heartbeat = heartbeats.contains(&PortId::from_index(at));
        self::port(hir, port, is_heartbeat, clock)
    });
    let ports = ports.collect();
    let couples = hir.couples.iter().filter_map(|couple| self::couple(&couple.kind, clock)).collect();
    let rules = if hir.paper { Rules::PAPER } else { Rules::DEFAULT };
    Cell { name: hir.name.clone(), tick, nodes, links, tasks, ports, couples, rules }
}

const fn via(kind: &CoupleKind) -> Option<PortId> {
    match kind {
        CoupleKind::Work { via, .. } => Some(*via),
        CoupleKind::Loose { .. } | CoupleKind::Tight(_) | CoupleKind::Serial(..) => None,
    }
}

/// Lowers a work couple. Rounds the lease up and the take-over down, so that a checker sees a late end of the lease and an
/// early take-over.
fn couple(kind: &CoupleKind, clock: &mut Clock) -> Option<CoupleDecl> {
    let CoupleKind::Work { primary, standby, mutual, lease, takeover, every, via } = *kind else {
        return None;
    };
    let (lease, takeover, every) = (clock.bound(lease), clock.time_out(takeover), clock.bound(every));
    Some(CoupleDecl { primary, standby, lease, takeover, every, via, trusted: false, mutual })
}

fn port(hir: &Hir, port: &Port, is_heartbeat: bool, clock: &mut Clock) -> PortDecl {
    let time_out = port.time_out.map_or(Ticks::ZERO, |length| clock.time_out(length));
    let users = port.users.iter().map(|user| UserDecl {
        time_out: user.time_out.map(|length| clock.time_out(length)),
        retry: user.retry,
        rate: user.rate.map(|(count, per)| Rate { count, per: clock.period(per) }),
        ..UserDecl::new(user.task)
    });
    let users = users.collect();
    let retry = port.users.iter().filter_map(|user| user.retry).fold(port.retry, u8::max);
    let resend = match port.resend {
        Some(length) => clock.time_out(length),
        None if retry > 0 => Ticks((time_out.0 / (u64::from(retry) + 1)).max(1)),
        None => Ticks::FAR,
    };
    let waitfor = port.usage == Usage::Waitfor;
    let packets = |fields: &[Field]| match u8::try_from(format(fields).fragments()) {
        Ok(packets) if !is_heartbeat => packets,
        _ => 1,
    };
    PortDecl {
        name: port.name.clone(),
        owner: port.owner,
        usage: port.usage,
        users,
        modules: Vec::new(),
        time_out,
        class: port.class,
        bounded_buffer: port.bounded_buffer,
        format: description(hir, port),
        retry: if waitfor { 0 } else { port.retry },
        resend,
        losses: if waitfor { retry } else { 0 },
        margin: hir.paper.then_some(Ticks::ZERO),
        penalty: penalty(hir, port, clock),
        latest: port.latest,
        fragments: if waitfor { 1 } else { packets(&port.message) },
        answer_fragments: packets(&port.answer),
        rate: port.rate.map(|(count, per)| Rate { count, per: clock.period(per) }),
        guard: port.guard.and_then(|couple| guard(hir, couple)),
    }
}

/// The penalty of a port. By the paper's rules every port has a penalty: a tick, if none is declared (Appendix, `save`).
fn penalty(hir: &Hir, port: &Port, clock: &mut Clock) -> Option<Penalty> {
    match (port.penalty, hir.tick) {
        (Some((length, literal)), _) => Some(Penalty { length: clock.bound(length), literal }),
        (None, Some(tick)) if hir.paper && port.usage != Usage::Waitfor => {
            Some(Penalty { length: clock.bound(tick), literal: true })
        }
        (None, _) => None,
    }
}

/// The position of a couple among the work couples of the cell.
fn guard(hir: &Hir, couple: usize) -> Option<u8> {
    let before = hir.couples.get(..couple)?.iter().filter(|couple| via(&couple.kind).is_some());
    u8::try_from(before.count()).ok()
}

/// The layout of a message with these fields.
pub(super) fn format(fields: &[Field]) -> Format {
    Format { fields: fields.iter().map(|field| field.of).collect() }
}

/// What both ends of a port must agree on: names and types of the fields. This text is part of the port's hash (D47).
fn description(hir: &Hir, port: &Port) -> String {
    let mut text = String::new();
    if let Some(record) = port.record.and_then(|record| hir.records.get(record)) {
        text.push_str(&record.name);
    }
    for (open, fields) in [("(", &port.message), (")->(", &port.answer)] {
        text.push_str(open);
        for field in fields {
            let _ = write!(text, "{}:{};", field.name, word(field.of));
        }
    }
    text.push(')');
    text
}
