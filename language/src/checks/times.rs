//! Checks durations against the tick, and declared rates against the links.

use super::{LEAST_TICKS, time};
use crate::codes::{LOAD, SHORT_TIME_OUT, SOON};
use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Port};
use imrs_protocol::{Class, NodeId, PortId, TaskId};

/// If a time_out has fewer ticks than this, the lateness of one tick matters.
const FEW_TICKS: u64 = 20;
/// The bits of a packet on the wire: 32 bytes, its envelope, IP and UDP, Ethernet and the gap.
const BITS: f64 = 138.0 * 8.0;
/// A load of a link above this value, in bits per second, is reported.
const PLENTY: f64 = 100e6;

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

/// Adds up the declared rates on each link.
fn loads(hir: &Hir, found: &mut Vec<Diagnostic>) {
    let mut loads = vec![0.0; hir.links.len()];
    for port in &hir.ports {
        let bytes: usize = port.message.iter().map(|field| field.of.bytes()).sum();
        let packets = bytes.div_ceil(12).max(1) as f64 * if port.class == Class::Command { 2.0 } else { 1.0 };
        for from in super::messages::senders(port) {
            let Some((count, per)) = port.user(from).and_then(|user| user.rate).or(port.rate) else {
                continue;
            };
            let rate = f64::from(count) * 1e6 / per.usec.max(1) as f64;
            for to in port.peers(from) {
                for link in hir.way(node(hir, from), node(hir, to)) {
                    loads[link] += rate * packets * BITS;
                }
            }
        }
    }
    for (link, load) in hir.links.iter().zip(loads).filter(|(_, load)| *load > PLENTY) {
        let message = format!(
            "the declared rates put up to {:.0} Mbit/s on the link of `{}` and `{}`",
            load / 1e6,
            hir.nodes[link.a.index()].name,
            hir.nodes[link.b.index()].name
        );
        found.push(
            Diagnostic::warning(LOAD, link.span, message)
                .label("138 bytes a packet, on the wire")
                .help("lower the rates, or join the nodes that talk most by links of their own"),
        );
    }
}

fn node(hir: &Hir, task: TaskId) -> NodeId {
    hir.tasks[task.index()].node
}
