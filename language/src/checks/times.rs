//! Checks durations against the tick, and declared rates against the links.

use super::{LEAST_TICKS, time};
use crate::codes::{LOAD, SHORT_TIME_OUT, SOON};
use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Port};
use crate::load::{self, WIRE_BYTES};
use imrs_protocol::PortId;

/// If a time_out has fewer ticks than this, the lateness of one tick matters.
const FEW_TICKS: u64 = 20;

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for (at, port) in hir.ports.iter().enumerate() {
        time_outs(hir, PortId::from_index(at), port, found);
    }
    loads(hir, found);
}

/// Compares the shortest time_out of a port with the tick.
fn time_outs(hir: &Hir, id: PortId, port: &Port, found: &mut Vec<Diagnostic>) {
    let Some(tick) = hir.tick.map(|tick| tick.usec.max(1)) else { return };
    let all = port.time_out.into_iter().chain(port.users.iter().filter_map(|user| user.time_out));
    let Some(ttl) = all.min_by_key(|ttl| ttl.usec) else { return };
    let ticks = ttl.usec / tick;
    let message = format!("time_out {} of `{}` is {ticks} ticks", time(ttl.usec), port.name);
    if ticks < LEAST_TICKS {
        found.push(
            Diagnostic::error(SHORT_TIME_OUT, ttl.span, message)
                .label(format!("under {LEAST_TICKS} ticks of {}", time(tick)))
                .also(port.span, "the port")
                .help(format!(
                    "give it {} or more, or the cell a shorter tick",
                    time(super::deadlines::least(hir, id, Some(ttl)))
                )),
        );
    } else if ticks < FEW_TICKS {
        found.push(
            Diagnostic::note(SOON, ttl.span, message)
                .label(format!("a timer may be late by one tick: {} percent of it", 100 / ticks)),
        );
    }
}

/// Compares the traffic on each link with what the link carries. Where a link declares no capacity, only declared rates count.
fn loads(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for (link, load) in hir.links.iter().zip(load::of_links(hir)) {
        let ends = [link.a, link.b].map(|node| &hir.nodes[node.index()].name);
        let (message, label) = if link.capacity.is_some() && load.is_congested() {
            let message = format!(
                "the link of `{}` and `{}` carries {:.0} packets a second, and gets up to {:.0}",
                ends[0],
                ends[1],
                load.capacity,
                load.total()
            );
            (message, format!("{:.0} of them are estimated from time_outs", load.estimated))
        } else if link.capacity.is_none() && load.declared > load.capacity {
            let message = format!(
                "the declared rates put up to {:.0} Mbit/s on the link of `{}` and `{}`",
                load.declared * WIRE_BYTES * 8.0 / 1e6,
                ends[0],
                ends[1]
            );
            (message, "138 bytes a packet, on the wire".into())
        } else {
            continue;
        };
        found.push(Diagnostic::warning(LOAD, link.span, message).label(label).help(
            "lower the rates, or join the nodes that talk most by links of their own; `imrs check --load` shows all links",
        ));
    }
}
