//! The fields of the monitor's rows that conditions can use.

use super::Value;
use crate::clock::{self, Moment};
use crate::store::health::{Finding, Place};
use crate::store::journal::{Entry, Severity};
use crate::store::meeting::state;
use crate::store::service::outlook;
use crate::store::{NodeIncarnation, Store};
use imrs_protocol::{Class, PortView};
use imrs_wire::obs::{Liveness, TaskSnapshot};
use std::borrow::Cow;

/// The type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A count or a percentage.
    Number,
    /// A length of time.
    Time,
    /// A name or word.
    Text,
}

/// The rows that have a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// The rows of the overview: nodes, tasks and ports.
    Rows,
    /// The events.
    Events,
    /// The rows of the overview and the events.
    Both,
}

/// The description of a field.
#[derive(Clone, Copy, Debug)]
pub struct FieldInfo {
    /// The field that is described.
    pub field: Field,
    /// The name of the field in conditions.
    pub name: &'static str,
    /// The type of the field.
    pub kind: Kind,
    /// The rows that have the field.
    pub scope: Scope,
    /// The meaning of the field.
    pub help: &'static str,
}

macro_rules! fields {
    ($($field:ident $name:literal $kind:ident $scope:ident $help:literal;)*) => {
        /// A field of a row, on which a condition can depend.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Field {
            $(#[doc = $help] $field,)*
        }

        /// All fields, in the order of the help.
        pub const FIELDS: &[FieldInfo] = &[$(FieldInfo {
            field: Field::$field,
            name: $name,
            kind: Kind::$kind,
            scope: Scope::$scope,
            help: $help,
        },)*];
    };
}

fields! {
    Cell "cell" Text Both "the cell";
    Node "node" Text Both "the node";
    Task "task" Text Both "the task";
    Port "port" Text Both "the port";
    State "state" Text Rows "what the task does: run, receive ..., reply ..., waitfor ..., delay, ended, crashed";
    Usage "usage" Text Rows "what the task does with the port: send, receive, query, response, reply, waitfor";
    Health "health" Text Both "ok, note, warning, critical";
    Code "code" Text Rows "what is wrong with the row: the code of `imrs explain`";
    Class "class" Number Both "1: status, 2: command";
    Len "len" Number Rows "messages that wait";
    Capacity "capacity" Number Rows "messages that may wait";
    Fill "fill" Number Rows "how full the buffer is, in percent";
    Slack "slack" Time Both "remaining time of the most urgent message";
    Rate "rate" Number Rows "messages a second, lately";
    Sent "sent" Number Rows "messages sent, or waitfors reached";
    Resent "resent" Number Rows "copies sent again";
    Enqueued "enqueued" Number Rows "messages that arrived";
    Delivered "delivered" Number Rows "messages taken, or waitfors released";
    Expired "expired" Number Rows "messages that expired here";
    Refused "refused" Number Rows "messages that found no space";
    Evicted "evicted" Number Rows "messages dropped for space";
    Rejected "rejected" Number Rows "times that a message was rejected by rank";
    Duplicates "duplicates" Number Rows "copies of messages seen before";
    TimedOut "timed_out" Number Rows "requests that ended by time_out";
    Dropped "dropped" Number Rows "other drops";
    Service "service" Time Rows "how long a message takes once it is its turn, 99th percentile";
    Kind "kind" Text Events "of an event: sent, delivered, discard, ...";
    Peer "peer" Text Events "of an event: the other task";
    Number "number" Number Events "of an event: the message or round";
    Ago "ago" Time Events "of an event: how long before the newest";
}

/// The field with this name or alias.
pub(super) fn find(name: &str) -> Option<&'static FieldInfo> {
    let name = match name {
        "in" => "enqueued",
        "served" => "delivered",
        "queue" => "len",
        other => other,
    };
    FIELDS.iter().find(|info| info.name == name)
}

/// A row with fields.
pub trait Row {
    /// The value of a field of this row.
    fn field(&self, field: Field) -> Value<'_>;
    /// Whether the names in the row contain `words`, which must be lower case.
    fn mentions(&self, words: &str) -> bool;
}

/// A row of a port, on the overview.
#[derive(Clone, Copy, Debug)]
pub struct PortRow<'a> {
    /// The store that contains the port.
    pub store: &'a Store,
    /// The node of the port.
    pub incarnation: &'a NodeIncarnation,
    /// The task that has the port.
    pub task: &'a TaskSnapshot,
    /// The port of the row.
    pub port: &'a PortView,
    /// All findings of the cell.
    pub findings: &'a [Finding],
    /// The moment that the screen shows.
    pub now: Moment,
}

/// A row of a node or task.
#[derive(Clone, Copy, Debug)]
pub struct NodeRow<'a> {
    /// The node of the row, or of the row's task.
    pub incarnation: &'a NodeIncarnation,
    /// The task, if the row is a task's.
    pub task: Option<&'a TaskSnapshot>,
    /// All findings of the cell.
    pub findings: &'a [Finding],
}

/// A row of an event in the event log.
#[derive(Clone, Copy, Debug)]
pub struct EventRow<'a> {
    /// The entry of the journal that the row shows.
    pub entry: &'a Entry,
    /// The moment relative to which the event's age is computed.
    pub now: Moment,
}

fn text<'a>(text: impl Into<Cow<'a, str>>) -> Value<'a> {
    Value::Text(text.into())
}

#[expect(clippy::cast_precision_loss, reason = "a count for comparing")]
const fn count(count: u64) -> Value<'static> {
    Value::Number(count as f64)
}

#[expect(clippy::cast_precision_loss, reason = "a time for comparing")]
const fn micros(us: u64) -> Value<'static> {
    Value::Time(us as f64)
}

const fn level(level: Option<Severity>) -> &'static str {
    match level {
        Some(Severity::Bad) => "critical",
        Some(Severity::Warn) => "warning",
        Some(Severity::Note | Severity::Trace) => "note",
        None => "ok",
    }
}

fn worst(findings: &[Finding], place: Place) -> Option<&Finding> {
    // The first finding that matches is the most severe one, because findings are sorted by severity.
    findings.iter().find(|finding| place.holds(&finding.place))
}

fn doing(incarnation: &NodeIncarnation, task: &TaskSnapshot) -> String {
    match task.liveness {
        Liveness::Alive => state(incarnation, &task.view.state),
        Liveness::Ended => "ended".to_owned(),
        Liveness::Crashed => "crashed".to_owned(),
    }
}

impl Row for PortRow<'_> {
    fn field(&self, field: Field) -> Value<'_> {
        let Self { store, incarnation, task, port, findings, now } = *self;
        let c = &port.counters;
        let place = Place { node: Ok(incarnation.id), task: Some(task.view.task), port: Some(port.port) };
        match field {
            Field::Port => text(incarnation.names.port_name(port.port).raw().to_owned()),
            Field::Usage => text(port.usage.word()),
            Field::Health => text(level(worst(findings, place).map(|f| f.level))),
            Field::Code => worst(findings, place).map_or(Value::Missing, |f| text(f.code)),
            Field::Class => count(if port.class == Class::Command { 2 } else { 1 }),
            Field::Len => count(port.len.into()),
            Field::Capacity => count(port.capacity.into()),
            Field::Fill if port.capacity == 0 => Value::Missing,
            Field::Fill => Value::Number(f64::from(port.len) * 100.0 / f64::from(port.capacity)),
            Field::Slack => {
                port.min_slack.map_or(Value::Missing, |s| micros(incarnation.left(s, task.age_us, now).us))
            }
            Field::Rate => incarnation.rate(task.view.task, port.port).map_or(Value::Missing, Value::Number),
            Field::Sent => count(c.sent),
            Field::Resent => count(c.resent),
            Field::Enqueued => count(c.enqueued),
            Field::Delivered => count(c.delivered),
            Field::Expired => count(c.expired),
            Field::Refused => count(c.refused),
            Field::Evicted => count(c.evicted),
            Field::Rejected => count(c.rejected),
            Field::Duplicates => count(c.duplicates),
            Field::TimedOut => count(c.timed_out),
            Field::Dropped => count(c.dropped),
            Field::Service => {
                let outlook = outlook(store, incarnation.id, task.view.task, port.port);
                outlook.p99_us.map_or(Value::Missing, micros)
            }
            Field::Cell | Field::Node | Field::Task | Field::State => {
                node_field(incarnation, Some(task), findings, field)
            }
            Field::Kind | Field::Peer | Field::Number | Field::Ago => Value::Missing,
        }
    }

    fn mentions(&self, words: &str) -> bool {
        let node = NodeRow { incarnation: self.incarnation, task: Some(self.task), findings: self.findings };
        self.incarnation.names.port_name(self.port.port).shown().to_lowercase().contains(words)
            || node.mentions(words)
    }
}

impl Row for NodeRow<'_> {
    fn field(&self, field: Field) -> Value<'_> {
        node_field(self.incarnation, self.task, self.findings, field)
    }

    fn mentions(&self, words: &str) -> bool {
        let has = |name: &crate::name::Name| name.shown().to_lowercase().contains(words);
        has(&self.incarnation.node)
            || self.task.is_some_and(|task| has(&self.incarnation.names.task(task.view.task)))
    }
}

fn node_field<'a>(
    incarnation: &'a NodeIncarnation,
    task: Option<&TaskSnapshot>,
    findings: &[Finding],
    field: Field,
) -> Value<'a> {
    let place = Place { node: Ok(incarnation.id), task: task.map(|t| t.view.task), port: None };
    match (field, task) {
        (Field::Cell, _) => text(incarnation.names.cell.raw()),
        (Field::Node, _) => text(incarnation.node.raw()),
        (Field::Task, Some(task)) => text(incarnation.names.task(task.view.task).raw().to_owned()),
        (Field::State, Some(task)) => text(doing(incarnation, task)),
        (Field::Health, _) => text(level(worst(findings, place).map(|f| f.level))),
        (Field::Code, _) => worst(findings, place).map_or(Value::Missing, |f| text(f.code)),
        _ => Value::Missing,
    }
}

impl Row for EventRow<'_> {
    fn field(&self, field: Field) -> Value<'_> {
        let Self { entry, now } = *self;
        let observed = entry.observed();
        match field {
            Field::Cell => text(entry.names.cell.raw()),
            Field::Node => text(entry.node.raw()),
            Field::Kind => text(entry.kind()),
            Field::Health => text(level((entry.level() > Severity::Trace).then(|| entry.level()))),
            Field::Ago => micros(clock::micros(now.saturating_sub(entry.at))),
            Field::Task => observed
                .and_then(|(task, _)| task)
                .map_or(Value::Missing, |task| text(entry.names.task(task).raw().to_owned())),
            Field::Port => {
                observed.map_or(Value::Missing, |(_, o)| text(entry.names.port_name(o.port).raw().to_owned()))
            }
            Field::Peer => {
                observed.map_or(Value::Missing, |(_, o)| text(entry.names.task(o.peer).raw().to_owned()))
            }
            Field::Number => observed.map_or(Value::Missing, |(_, o)| count(o.number.into())),
            Field::Class => observed
                .and_then(|(_, o)| entry.names.port(o.port))
                .map_or(Value::Missing, |port| count(if port.class == Class::Command { 2 } else { 1 })),
            Field::Slack => observed.map_or(Value::Missing, |(_, o)| micros(o.remaining.0)),
            _ => Value::Missing,
        }
    }

    fn mentions(&self, words: &str) -> bool {
        self.entry.mentions(words)
    }
}
