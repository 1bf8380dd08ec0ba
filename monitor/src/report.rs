//! Prints the state of a cell as JSON or text, for pipes, tests and screen readers.

mod assertions;
mod links;
mod text;

pub use assertions::{json_of_assertions, text_of_assertions};
pub use text::text;

use crate::clock::Moment;
use crate::name::Name;
use crate::replay::tell::Position;
use crate::replay::{Player, tell};
use crate::store::conformance::{Verdict, conformance};
use crate::store::health::{Finding, findings};
use crate::store::journal::Severity;
use crate::store::{NodeIncarnation, Store, unseen};
use imrs_protocol::{Class, MeetingState, MeetingView, PortView, TaskState};
use imrs_wire::obs::{Count, LinkSummary, Liveness, RealTime, TaskSnapshot};
use serde::Serialize;

/// The version of the JSON format. Later releases may add fields, but never change or remove any.
const VERSION: u32 = 1;

#[derive(Serialize)]
struct Report<'a> {
    version: u32,
    nodes: Vec<Node<'a>>,
    findings: Vec<Found>,
    /// The nodes to which attaching failed, each with the reason.
    troubles: Vec<&'a str>,
    /// The position in the recording, if a recording is shown.
    #[serde(skip_serializing_if = "Option::is_none")]
    replay: Option<Position<'a>>,
}

#[derive(Serialize)]
struct Node<'a> {
    cell: &'a str,
    name: &'a str,
    up: bool,
    /// The node's state: `up`, `silent`, `stopped`, `dead`, `unseen`.
    state: &'static str,
    incarnation: Option<u8>,
    pid: Option<u32>,
    build: Option<&'a str>,
    uptime_us: Option<u64>,
    insecure: Option<bool>,
    /// The longest time for which a script of the node is still held back after a restart; `None` if no script is held back.
    held_back_us: Option<u64>,
    /// If the node asked for real time: `had`, or the parts that the kernel refused.
    real_time: Option<String>,
    transit: Transit,
    discards: Vec<Reason<'a>>,
    link_discards: Vec<Reason<'a>>,
    /// The links from its neighbours, as the node measures them.
    links: Vec<LinkSummary>,
    lost_events: u64,
    /// The validator's verdict on the inputs that the node records: `conforms`, `violates` or `unknown`.
    conformance: &'static str,
    /// How many steps of the node the validator has checked.
    conforming_steps: u64,
    tasks: Vec<Task<'a>>,
}

#[derive(Default, Serialize)]
struct Transit {
    len: u16,
    capacity: u16,
    min_slack_us: Option<u64>,
    forwarded: u64,
}

#[derive(Serialize)]
struct Reason<'a> {
    reason: &'a str,
    count: u64,
}

#[derive(Serialize)]
struct Task<'a> {
    name: &'a str,
    /// What the task does: `run`, `receive`, `await_reply`, `waitfor`, `delay`, `ended` or `crashed`.
    state: &'static str,
    /// How long the task's script is still held back after a restart of its node.
    held_back_us: Option<u64>,
    ports: Vec<Port<'a>>,
    waitfor: Vec<Waitfor<'a>>,
}

#[derive(Serialize)]
struct Port<'a> {
    name: &'a str,
    usage: &'static str,
    class: u8,
    len: u16,
    capacity: u16,
    min_slack_us: Option<u64>,
    sent: u64,
    resent: u64,
    enqueued: u64,
    delivered: u64,
    expired: u64,
    refused: u64,
    rejected: u64,
    evicted: u64,
    duplicates: u64,
    timed_out: u64,
    dropped: u64,
    /// Always 0: nodes report penalties per message ([`imrs_wire::obs::Detail`]), not per port.
    penalty_us: u64,
}

#[derive(Serialize)]
struct Waitfor<'a> {
    port: &'a str,
    round: u16,
    /// The member's state at the rendezvous: `away`, `gathering`, `within_margin`.
    state: &'static str,
    released: u16,
    members: Vec<Member<'a>>,
    remaining_us: Option<u64>,
}

#[derive(Serialize)]
struct Member<'a> {
    task: &'a str,
    arrived: bool,
    confirmed: bool,
}

#[derive(Serialize)]
struct Found {
    level: &'static str,
    code: &'static str,
    node: Option<String>,
    task: Option<String>,
    port: Option<String>,
    text: String,
}

/// The cells of a store, sorted. If `only` is given, only the cell of that name.
#[must_use]
pub fn cells(store: &Store, only: Option<&str>) -> Vec<Name> {
    let mut cells = store.cells();
    cells.retain(|c| only.is_none_or(|only| c.raw() == only));
    cells
}

/// Whether any finding in the selected cells is critical.
#[must_use]
pub fn is_critical(store: &Store, only: Option<&str>, now: Moment) -> bool {
    cells(store, only).iter().any(|cell| findings(store, cell, now).iter().any(|f| f.level == Severity::Bad))
}

/// The selected cells as one line of JSON, without the newline.
///
/// # Panics
/// Never: every key is a string, so the encoding can only run out of memory.
#[must_use]
pub fn json(store: &Store, only: Option<&str>, now: Moment) -> String {
    whole(store, only, now, None)
}

/// The selected cells of a recording as one line of JSON, with the position in the recording.
///
/// # Panics
/// Never.
#[must_use]
pub fn json_of_replay(player: &Player, only: Option<&str>) -> String {
    whole(player.store(), only, player.moment(), Some(tell::position(player)))
}

/// The shown stop of a recording as text, one fact per line.
#[must_use]
pub fn text_of_replay(player: &Player, only: Option<&str>) -> String {
    tell::text(player) + &text(player.store(), only, player.moment())
}

fn whole(store: &Store, only: Option<&str>, now: Moment, replay: Option<Position<'_>>) -> String {
    let cells = cells(store, only);
    let troubles = store.troubles().collect();
    let mut report = Report { version: VERSION, nodes: Vec::new(), findings: Vec::new(), troubles, replay };
    let unseen: Vec<_> = cells.iter().map(|cell| unseen(store, cell)).collect();
    for (cell, unseen) in cells.iter().zip(&unseen) {
        report.nodes.extend(store.incarnations_of(cell).map(|incarnation| node(store, incarnation, now)));
        report.nodes.extend(unseen.iter().map(|one| not_seen(cell, &one.name, one.is_killed)));
        report.findings.extend(findings(store, cell, now).iter().map(|f| found(store, cell, f)));
    }
    imrs_wire::text::json(&serde_json::to_string(&report).expect("a report is plain data")).into_owned()
}

fn node<'a>(store: &Store, incarnation: &'a NodeIncarnation, now: Moment) -> Node<'a> {
    let judged = conformance(store, incarnation.id);
    use crate::store::Presence::{Dead, Silent, Stopped, Up};
    let presence = incarnation.presence(now);
    let snapshot = incarnation.last.as_ref().map(|s| &*s.snapshot);
    let transit = snapshot.map_or_else(Transit::default, |s| Transit {
        len: s.transit.len,
        capacity: s.transit.capacity,
        min_slack_us: s.transit.min_slack.map(|t| incarnation.left(t, s.transit_age_us, now).us),
        forwarded: s.transit.forwarded,
    });
    Node {
        cell: incarnation.names.cell.raw(),
        name: incarnation.node.raw(),
        up: matches!(presence, Up | Silent(_)),
        state: match presence {
            Up => "up",
            Silent(_) => "silent",
            Stopped(_) => "stopped",
            Dead(_) => "dead",
        },
        incarnation: Some(incarnation.number),
        pid: Some(incarnation.pid),
        build: Some(incarnation.build.raw()),
        uptime_us: snapshot.map(|s| s.uptime_us),
        insecure: snapshot.map(|s| s.insecure),
        held_back_us: incarnation.longest_held_back(now),
        real_time: snapshot.and_then(|s| real_time(s.real_time)),
        transit,
        discards: snapshot.map_or(&[][..], |s| &s.discards).iter().map(reason).collect(),
        link_discards: snapshot.map_or(&[][..], |s| &s.link_discards).iter().map(reason).collect(),
        links: links::links(incarnation, now),
        lost_events: incarnation.lost,
        conformance: match judged.verdict {
            Verdict::Unknown { .. } => "unknown",
            Verdict::Conforms => "conforms",
            Verdict::Violates { .. } => "violates",
        },
        conforming_steps: judged.steps,
        tasks: incarnation.tasks().iter().map(|t| task(incarnation, t, now)).collect(),
    }
}

fn real_time(of: RealTime) -> Option<String> {
    let RealTime::Refused { memory, scheduler, core } = of else {
        return (of == RealTime::Had).then(|| "had".to_owned());
    };
    let all = [(memory, "memory"), (scheduler, "scheduler"), (core, "core")];
    let refused: Vec<&str> = all.into_iter().filter_map(|(refused, what)| refused.then_some(what)).collect();
    Some(format!("refused: {}", refused.join(", ")))
}

fn reason(count: &Count) -> Reason<'_> {
    Reason { reason: &count.name, count: count.count }
}

fn not_seen<'a>(cell: &'a Name, name: &'a Name, killed: bool) -> Node<'a> {
    Node {
        cell: cell.raw(),
        name: name.raw(),
        up: false,
        state: if killed { "dead" } else { "unseen" },
        incarnation: None,
        pid: None,
        build: None,
        uptime_us: None,
        insecure: None,
        held_back_us: None,
        real_time: None,
        transit: Transit::default(),
        discards: Vec::new(),
        link_discards: Vec::new(),
        links: Vec::new(),
        lost_events: 0,
        conformance: "unknown",
        conforming_steps: 0,
        tasks: Vec::new(),
    }
}

fn task<'a>(incarnation: &'a NodeIncarnation, task: &'a TaskSnapshot, now: Moment) -> Task<'a> {
    let state = match (task.liveness, task.view.state) {
        (Liveness::Crashed, _) => "crashed",
        (Liveness::Ended, _) => "ended",
        (Liveness::Alive, TaskState::Running) => "run",
        (Liveness::Alive, TaskState::Receiving { .. }) => "receive",
        (Liveness::Alive, TaskState::AwaitingReply { .. }) => "await_reply",
        (Liveness::Alive, TaskState::Waiting { .. }) => "waitfor",
        (Liveness::Alive, TaskState::Delaying) => "delay",
    };
    Task {
        name: raw_task(incarnation, task.view.task),
        state,
        held_back_us: incarnation.task_held_back(task.view.task, now),
        ports: task.view.ports.iter().map(|p| port(incarnation, task, p, now)).collect(),
        waitfor: task.view.meetings.iter().map(|m| waitfor(incarnation, task, m, now)).collect(),
    }
}

fn raw_task(incarnation: &NodeIncarnation, id: imrs_protocol::TaskId) -> &str {
    incarnation.names.tasks.get(id.index()).map_or("?", |t| t.name.raw())
}

fn raw_port(incarnation: &NodeIncarnation, id: imrs_protocol::PortId) -> &str {
    incarnation.names.port(id).map_or("?", |p| p.name.raw())
}

fn port<'a>(incarnation: &'a NodeIncarnation, task: &TaskSnapshot, view: &PortView, now: Moment) -> Port<'a> {
    let c = &view.counters;
    Port {
        name: raw_port(incarnation, view.port),
        usage: view.usage.word(),
        class: if view.class == Class::Command { 2 } else { 1 },
        len: view.len,
        capacity: view.capacity,
        min_slack_us: view.min_slack.map(|s| incarnation.left(s, task.age_us, now).us),
        sent: c.sent,
        resent: c.resent,
        enqueued: c.enqueued,
        delivered: c.delivered,
        expired: c.expired,
        refused: c.refused,
        rejected: c.rejected,
        evicted: c.evicted,
        duplicates: c.duplicates,
        timed_out: c.timed_out,
        dropped: c.dropped,
        penalty_us: 0,
    }
}

fn waitfor<'a>(
    incarnation: &'a NodeIncarnation,
    task: &TaskSnapshot,
    view: &MeetingView,
    now: Moment,
) -> Waitfor<'a> {
    let member = |m: &imrs_protocol::MemberView| Member {
        task: raw_task(incarnation, m.task),
        arrived: m.arrived,
        confirmed: m.confirmed,
    };
    Waitfor {
        port: raw_port(incarnation, view.port),
        round: view.round.0,
        state: match view.state {
            MeetingState::Away => "away",
            MeetingState::Gathering => "gathering",
            MeetingState::WithinMargin => "within_margin",
        },
        released: view.released.0,
        members: view.members.iter().map(member).collect(),
        remaining_us: view.remaining.map(|r| incarnation.left(r, task.age_us, now).us),
    }
}

fn found(store: &Store, cell: &Name, finding: &Finding) -> Found {
    let incarnation = finding.place.node.ok().and_then(|id| store.incarnation(id));
    let names = store.names(cell);
    let unseen = finding.place.node.err().and_then(|id| names.map(|n| n.node(id).raw().to_owned()));
    Found {
        level: match finding.level {
            Severity::Bad => "critical",
            Severity::Warn => "warning",
            Severity::Note | Severity::Trace => "note",
        },
        code: finding.code,
        node: incarnation.map(|l| l.node.raw().to_owned()).or(unseen),
        task: incarnation.zip(finding.place.task).map(|(l, t)| raw_task(l, t).to_owned()),
        port: incarnation.zip(finding.place.port).map(|(l, p)| raw_port(l, p).to_owned()),
        text: finding.text.to_string(),
    }
}

/// One node at a moment, in the format of [`json`].
pub(crate) fn node_value(store: &Store, incarnation: &NodeIncarnation, now: Moment) -> serde_json::Value {
    serde_json::to_value(node(store, incarnation, now)).unwrap_or_default()
}
