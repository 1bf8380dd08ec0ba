//! Findings of a port: recent losses, and losses to come. Only the most significant loss is reported, because a flood
//! also causes evictions and expiries.

use super::codes::{self, Lint};
use super::{Finding, Lately, Place};
use crate::clock::Span;
use crate::store::incarnation::port_of;
use crate::store::meeting::state;
use crate::store::service::outlook;
use crate::store::{NodeIncarnation, Store};
use imrs_protocol::{Class, PortCounters, PortView};
use imrs_wire::obs::TaskSnapshot;

/// A message that was rejected this often is about to starve (R16, D58).
const REJECTIONS: u32 = 3;
/// A port has a flood if, in the last few seconds, at least this many of its class-1 messages were dropped for lack of
/// room, and these are at least a quarter of the messages that arrived.
const FLOOD: u64 = 10;

pub(super) fn look(
    store: &Store,
    incarnation: &NodeIncarnation,
    lately: &Lately<'_>,
    task: &TaskSnapshot,
    found: &mut Vec<Finding>,
) {
    let earlier = lately.before.and_then(|s| s.tasks.iter().find(|t| t.view.task == task.view.task));
    let state = || state(incarnation, &task.view.state);
    for (at, port) in task.view.ports.iter().enumerate() {
        let place = Place { task: Some(task.view.task), port: Some(port.port), ..Place::node(incarnation) };
        // A node lists its ports in the same order every time, so the port's earlier state is most likely at the same
        // position.
        let there = earlier.and_then(|task| task.view.ports.get(at)).filter(|there| there.port == port.port);
        let earlier = there.or_else(|| port_of(earlier?, port.port));
        if let Some((lint, text)) = earlier.and_then(|e| grown(port.class, &e.counters, &port.counters)) {
            // The cause of a loss at a receiver is either what the receiver does instead of receiving, or a sender
            // that sends too much.
            let text = match lint.code {
                "refused" | "expired" | "evicted" | "command-evicted" if port.capacity > 0 => {
                    format!("{text}: {}/{} wait, task: {}", port.len, port.capacity, state())
                }
                "status-flood" => {
                    text.replacen("flood", &format!("flood from {}", senders(incarnation, task, port)), 1)
                }
                _ => text,
            };
            found.push(Finding::new(lint, place, text));
        }
        if port.len > 0
            && let Some((lint, text)) = waiting(store, incarnation, task, port)
        {
            found.push(Finding::new(lint, place, text));
        }
    }
}

/// The tasks that send at a port.
fn senders(incarnation: &NodeIncarnation, task: &TaskSnapshot, port: &PortView) -> String {
    let parties = incarnation.names.port(port.port).map_or(&[][..], |info| &info.parties);
    let others = parties.iter().filter(|party| party.task != task.view.task);
    let names: Vec<_> = others.take(3).map(|party| incarnation.names.task(party.task).to_string()).collect();
    names.join(", ")
}

/// The recent losses of a port; only the most significant one.
fn grown(class: Class, before: &PortCounters, after: &PortCounters) -> Option<(&'static Lint, String)> {
    let more = |of: fn(&PortCounters) -> u64| of(after).saturating_sub(of(before));
    let (evicted, refused) = (more(|c| c.evicted), more(|c| c.refused));
    let came = more(|c| c.enqueued).saturating_add(refused);
    let dropped = evicted.saturating_add(refused);
    if class == Class::Status && dropped >= FLOOD && dropped.saturating_mul(4) >= came {
        return Some((&codes::STATUS_FLOOD, format!("flood: {dropped} of {came} dropped for space")));
    }
    let evicted_as = if class == Class::Command { &codes::COMMAND_EVICTED } else { &codes::EVICTED };
    let rows = [
        (evicted_as, "evicted for space", if class == Class::Command { evicted } else { 0 }),
        (&codes::TIME_OUTS, "time-outs of requests", more(|c| c.timed_out)),
        (&codes::REFUSED, "refused for space", refused),
        (evicted_as, "evicted for space", evicted),
        (&codes::EXPIRED, "expired", more(|c| c.expired)),
    ];
    let (lint, words, count) = rows.into_iter().find(|(.., count)| *count > 0)?;
    Some((lint, format!("{words} (+{count})")))
}

/// Reports a queued message that will starve or expire.
fn waiting(
    store: &Store,
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    port: &PortView,
) -> Option<(&'static Lint, String)> {
    let outlook = outlook(store, incarnation.id, task.view.task, port.port);
    let waits =
        |source, number| port.queue.iter().any(|e| (e.source, e.id.sequence.get()) == (source, number));
    let starved = outlook.most_rejected.filter(|(.., times)| *times >= REJECTIONS);
    if let Some((source, number, times)) = starved
        && waits(source, number)
    {
        let from = incarnation.names.task(source);
        return Some((&codes::STARVING, format!("starving, rejected {times} times: #{number} of {from}")));
    }
    // This uses the remaining time in the node's sample. If it were counted down here, a message that was taken since
    // the snapshot would raise an alarm.
    for (position, entry) in port.queue.iter().enumerate() {
        let left = incarnation.left_when_seen(entry.remaining, task.age_us);
        if let Some(needed) = outlook.done_in(position)
            && left < needed
        {
            let from = incarnation.names.task(entry.source);
            let text = format!(
                "expiring: #{} of {from} has {} left and needs {}",
                entry.id.sequence.get(),
                Span::micros(left),
                Span::micros(needed)
            );
            return Some((&codes::DEADLINE_RISK, text));
        }
    }
    let left = incarnation.left_when_seen(port.min_slack?, task.age_us);
    let whole = incarnation.names.port(port.port)?.time_out(task.view.task)?;
    let late = left < whole.0.saturating_mul(incarnation.tick_us) / 10;
    late.then(|| (&codes::DEADLINE_RISK, "expiring: a message has a tenth of its TTL left".to_owned()))
}
