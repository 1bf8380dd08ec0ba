//! Exports a recording as MCAP with JSON messages. There is one channel per port, flat and numeric, so that every field
//! can be plotted. There is one channel for the state of each node, one for events, and a log in Foxglove's schema.

use super::{ExportError, Exported, each_frame, jsonl};
use crate::clock::{Moment, micros};
use crate::replay::Film;
use crate::report;
use crate::source::Feed;
use crate::store::journal::Severity;
use crate::store::{NodeIncarnation, Store};
use imrs_protocol::{Class, PortView};
use imrs_wire::obs::{ServerFrame, TaskSnapshot};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Seek, Write};

/// The fields of a port's messages, with their descriptions.
const PORT: &[(&str, &str)] = &[
    ("len", "messages that wait"),
    ("capacity", "messages that may wait"),
    ("min_slack_ms", "remaining time of the most urgent one, milliseconds; -1: none waits"),
    ("sent", "messages sent"),
    ("delivered", "messages taken"),
    ("expired", "messages that expired here"),
    ("refused", "messages that found no space"),
    ("evicted", "messages dropped for space"),
    ("rejected", "rejections by rank"),
    ("timed_out", "requests that ended by time_out"),
    ("class", "1: status, 2: command"),
];

pub(super) fn write(film: &Film, out: impl Write + Seek) -> Result<Exported, ExportError> {
    let options = WriteOptions::new().compression(None).profile("").library("imrs");
    let mut tape = Tape { writer: options.create(out)?, channels: BTreeMap::new(), count: 0 };
    let mut told = BTreeSet::new();
    each_frame(film, |store, arrival| {
        let at = arrival.at;
        let incarnation = store.incarnation_of(arrival.source);
        match (&arrival.feed, incarnation) {
            (Feed::Frame(frame), Some(incarnation)) => match &**frame {
                ServerFrame::Events(events) => {
                    for event in &events.events {
                        tape.put("/events", &EVENT, at, &jsonl::event(incarnation, micros(at), event))?;
                    }
                }
                frame if jsonl::is_state(frame) => state(&mut tape, store, incarnation, at)?,
                _ => {}
            },
            (Feed::Lost { why }, Some(incarnation)) => {
                tape.put(
                    "/log",
                    &LOG,
                    at,
                    &log(at, Severity::Bad, incarnation.node.raw(), &format!("gone: {why}")),
                )?;
            }
            _ => {}
        }
        findings(&mut tape, store, at, &mut told)
    })?;
    let count = tape.count;
    tape.writer.finish()?;
    Ok(Exported { count, what: "messages" })
}

fn state<W: Write + Seek>(
    tape: &mut Tape<W>,
    store: &Store,
    incarnation: &NodeIncarnation,
    at: Moment,
) -> Result<(), ExportError> {
    let node = topic(incarnation.node.raw());
    tape.put(&format!("/nodes/{node}/state"), &STATE, at, &report::node_value(store, incarnation, at))?;
    for task in incarnation.tasks() {
        for port in &task.view.ports {
            let (of, name) = (incarnation.names.task(task.view.task), incarnation.names.port_name(port.port));
            let name = format!("/nodes/{node}/{}/{}", topic(of.raw()), topic(name.raw()));
            tape.put(&name, &PORT_SCHEMA, at, &flat(incarnation, task, port, at))?;
        }
    }
    Ok(())
}

fn flat(incarnation: &NodeIncarnation, task: &TaskSnapshot, port: &PortView, at: Moment) -> Value {
    let c = &port.counters;
    #[expect(clippy::cast_precision_loss, reason = "milliseconds for a plot")]
    let slack = port.min_slack.map_or(-1.0, |s| incarnation.left(s, task.age_us, at).us as f64 / 1000.0);
    json!({
        "len": port.len, "capacity": port.capacity, "min_slack_ms": slack,
        "sent": c.sent, "delivered": c.delivered, "expired": c.expired, "refused": c.refused,
        "evicted": c.evicted, "rejected": c.rejected, "timed_out": c.timed_out,
        "class": if port.class == Class::Command { 2 } else { 1 },
    })
}

/// Logs the new findings. A finding is logged once for as long as it lasts.
fn findings<W: Write + Seek>(
    tape: &mut Tape<W>,
    store: &Store,
    at: Moment,
    told: &mut BTreeSet<(String, String)>,
) -> Result<(), ExportError> {
    let mut now = BTreeSet::new();
    for cell in store.cells() {
        for finding in crate::store::health::findings(store, &cell, at) {
            let incarnation = finding.place.node.ok().and_then(|id| store.incarnation(id));
            let node = incarnation
                .map_or_else(|| cell.raw().to_owned(), |incarnation| incarnation.node.raw().to_owned());
            let port = incarnation.zip(finding.place.port).map(|(l, p)| format!(" {}", l.names.port_name(p)));
            let key = (node.clone() + port.as_deref().unwrap_or_default(), finding.code.to_owned());
            if !told.contains(&key) {
                let text = format!("{}{}: {}", finding.code, port.unwrap_or_default(), finding.text);
                tape.put("/log", &LOG, at, &log(at, finding.level, &node, &text))?;
            }
            now.insert(key);
        }
    }
    *told = now;
    Ok(())
}

/// A message in the schema `foxglove.Log`.
fn log(at: Moment, level: Severity, name: &str, message: &str) -> Value {
    let level = match level {
        Severity::Trace => 1,
        Severity::Note => 2,
        Severity::Warn => 3,
        Severity::Bad => 4,
    };
    json!({
        "timestamp": {"sec": at.as_secs(), "nsec": at.subsec_nanos()},
        "level": level, "message": message, "name": name, "file": "", "line": 0,
    })
}

/// Converts a name to a segment of a topic.
fn topic(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "_-.".contains(c) { c } else { '_' }).collect()
}

struct Schema {
    name: &'static str,
    text: fn() -> Value,
}

const LOG: Schema = Schema {
    name: "foxglove.Log",
    text: || {
        json!({"type": "object", "properties": {
            "timestamp": {"type": "object", "title": "time",
                          "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
            "level": {"type": "integer", "description": "1 debug, 2 info, 3 warning, 4 error, 5 fatal"},
            "message": {"type": "string"}, "name": {"type": "string"},
            "file": {"type": "string"}, "line": {"type": "integer"},
        }})
    },
};

const EVENT: Schema = Schema {
    name: "imrs.Event",
    text: || {
        json!({"type": "object", "properties": {
            "at_us": {"type": "integer"}, "what": {"type": "string"}, "node": {"type": "string"},
            "mono_us": {"type": "integer", "description": "the node's own clock"}, "task": {"type": "string"},
            "event": {"type": "string"}, "reason": {"type": "string"}, "port": {"type": "string"},
            "peer": {"type": "string"}, "number": {"type": "integer"}, "remaining_us": {"type": "integer"},
        }})
    },
};

const STATE: Schema = Schema { name: "imrs.Node", text: || json!({"type": "object"}) };

const PORT_SCHEMA: Schema = Schema {
    name: "imrs.Port",
    text: || {
        let field = |(name, help): &(&str, &str)| {
            ((*name).to_owned(), json!({"type": "number", "description": help}))
        };
        let fields: serde_json::Map<String, Value> = PORT.iter().map(field).collect();
        json!({"type": "object", "properties": fields})
    },
};

struct Tape<W: Write + Seek> {
    writer: Writer<W>,
    /// For each topic: its channel, and the number of its messages.
    channels: BTreeMap<String, (u16, u32)>,
    count: usize,
}

impl<W: Write + Seek> Tape<W> {
    fn put(&mut self, topic: &str, schema: &Schema, at: Moment, message: &Value) -> Result<(), ExportError> {
        if !self.channels.contains_key(topic) {
            let text = (schema.text)().to_string();
            let of = self.writer.add_schema(schema.name, "jsonschema", text.as_bytes())?;
            let channel = self.writer.add_channel(of, topic, "json", &BTreeMap::new())?;
            self.channels.insert(topic.to_owned(), (channel, 0));
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(topic) else { return Ok(()) };
        let nanos = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        *sequence += 1;
        self.count += 1;
        Ok(self.writer.write_to_known_channel(&header, message.to_string().as_bytes())?)
    }
}
