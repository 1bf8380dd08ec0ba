//! Exports a recording as lines of JSON: one for each state of a node, and one for each event.

use super::{ExportError, Exported, each_frame};
use crate::clock::micros;
use crate::replay::Film;
use crate::report;
use crate::source::{Arrival, Feed};
use crate::store::journal::word;
use crate::store::{NodeIncarnation, Store};
use imrs_protocol::Event;
use imrs_wire::obs::{ServerFrame, TimedEvent};
use imrs_wire::text;
use serde_json::{Value, json};
use std::io::Write;

pub(super) fn write(film: &Film, mut out: impl Write) -> Result<Exported, ExportError> {
    let mut count = 0;
    each_frame(film, |store, arrival| {
        for line in lines(store, arrival) {
            writeln!(out, "{}", text::json(&line.to_string()))?;
            count += 1;
        }
        Ok::<(), ExportError>(())
    })?;
    out.flush()?;
    Ok(Exported { count, what: "lines" })
}

fn lines(store: &Store, arrival: &Arrival) -> Vec<Value> {
    let (at_us, source) = (micros(arrival.at), arrival.source);
    let incarnation = store.incarnation_of(source);
    let node = incarnation.map(|incarnation| incarnation.node.raw().to_owned());
    match &arrival.feed {
        Feed::Attached { identity, pid, build } => vec![json!({
            "at_us": at_us, "what": "attached", "cell": identity.cell, "node": identity.node,
            "incarnation": identity.incarnation.0, "pid": pid, "build": build,
        })],
        Feed::Lost { why } => vec![json!({"at_us": at_us, "what": "lost", "node": node, "why": why})],
        Feed::Frame(frame) => match &**frame {
            ServerFrame::Events(events) => {
                let Some(incarnation) = incarnation else { return Vec::new() };
                let gap = (events.lost > 0).then(
                    || json!({"at_us": at_us, "what": "gap", "node": node, "lost_events": events.lost}),
                );
                gap.into_iter()
                    .chain(events.events.iter().map(|event| self::event(incarnation, at_us, event)))
                    .collect()
            }
            ServerFrame::Bye(_) => vec![json!({"at_us": at_us, "what": "stopped", "node": node})],
            ServerFrame::Table(_) => Vec::new(),
            _ => incarnation.filter(|_| is_state(frame)).map_or_else(Vec::new, |incarnation| {
                vec![json!({"at_us": at_us, "what": "state", "state": report::node_value(store, incarnation, arrival.at)})]
            }),
        },
        Feed::Judged { .. } | Feed::Failed { .. } | Feed::Left | Feed::Stale { .. } => Vec::new(),
    }
}

/// Whether a frame carries the state of a node.
pub(super) const fn is_state(frame: &ServerFrame) -> bool {
    matches!(frame, ServerFrame::Snapshot(_) | ServerFrame::Delta(_))
}

/// An event as JSON, with the names of the cell.
pub(super) fn event(incarnation: &NodeIncarnation, at_us: u64, event: &TimedEvent) -> Value {
    let what = event.what;
    let reason = match what.event {
        Event::Discarded(reason) => Some(reason.name()),
        _ => None,
    };
    json!({
        "at_us": at_us,
        "what": "event",
        "node": incarnation.node.raw(),
        // The time of the node's own clock: only differences between times of one node are meaningful.
        "mono_us": event.mono_us,
        "task": event.task.map(|task| incarnation.names.task(task).raw().to_owned()),
        "event": word(what.event),
        "reason": reason,
        "port": incarnation.names.port(what.port).map(|port| port.name.raw()),
        "peer": incarnation.names.task(what.peer).raw(),
        "number": what.number,
        "remaining_us": what.remaining.0.saturating_mul(incarnation.tick_us),
    })
}
