//! A cell of any size, as its nodes would tell of it: what measurements of the screens look at.

use crate::clock::Moment;
use crate::source::{Arrival, Feed, SourceId};
use imrs_protocol::{
    Class, Event, Incarnation, MessageId, NodeId, Observation, PortCounters, PortId, PortView, QueueEntry,
    Seq24, TaskId, TaskState, TaskView, Ticks, Usage,
};
use imrs_wire::obs::{
    Events, LinkName, Liveness, NodeIdentity, NodeName, PartyName, PortName, ServerFrame, Snapshot, Table,
    TaskName, TaskSnapshot, TimedEvent,
};

/// How large: so many nodes in a ring, each with one task, that with so many ports on which the next node's task sends.
#[derive(Clone, Copy, Debug)]
pub struct Specimen {
    /// The nodes.
    pub nodes: u16,
    /// The ports that each of them receives at.
    pub ports: u16,
}

impl Specimen {
    /// What the nodes say when a monitor attaches, and then once more at `at`: so many waiting messages at every
    /// seventh port, and the events of a hundredth of a second.
    #[must_use]
    pub fn arrivals(&self, at: Moment) -> Vec<Arrival> {
        (0..self.nodes).flat_map(|node| self.node(node, at)).collect()
    }

    fn node(&self, node: u16, at: Moment) -> Vec<Arrival> {
        let identity = NodeIdentity {
            cell: "specimen".into(),
            digest: 1,
            node: format!("node{node}"),
            id: node,
            incarnation: Incarnation(1),
            tick_us: 1,
        };
        let attached = Feed::Attached { identity, pid: 1_000 + u32::from(node), build: "imrs".into() };
        let arrival = |feed| Arrival { at, source: SourceId(node.into()), feed };
        let said = |frame| arrival(Feed::Frame(Box::new(frame)));
        vec![
            arrival(attached),
            said(ServerFrame::Table(self.table())),
            said(ServerFrame::Snapshot(self.snapshot(node))),
            said(ServerFrame::Events(self.events(node))),
        ]
    }

    /// The task that sends to those of `node`.
    const fn sender(&self, node: u16) -> TaskId {
        TaskId((node + 1) % self.nodes)
    }

    fn table(&self) -> Table {
        let party = |task, usage| PartyName { task, usage, time_out: Ticks(200_000) };
        let port = |i: u16| {
            let owner = i / self.ports;
            PortName {
                name: format!("port{i}"),
                class: Class::Status,
                capacity: 8,
                margin: Ticks::ZERO,
                parties: vec![party(TaskId(owner), Usage::Receive), party(self.sender(owner), Usage::Send)],
            }
        };
        let link = |i: u16| LinkName { a: NodeId(i), b: NodeId((i + 1) % self.nodes), delay: Ticks(5_000) };
        Table {
            cell: "specimen".into(),
            tick: Ticks(1_000),
            nodes: (0..self.nodes).map(|i| NodeName { name: format!("node{i}") }).collect(),
            links: (0..self.nodes).map(link).collect(),
            tasks: (0..self.nodes).map(|i| TaskName { name: format!("task{i}"), node: NodeId(i) }).collect(),
            ports: (0..self.nodes.saturating_mul(self.ports)).map(port).collect(),
        }
    }

    /// The state of a node.
    #[must_use]
    pub fn snapshot(&self, node: u16) -> Snapshot {
        let entry = |n: u32| QueueEntry {
            source: self.sender(node),
            id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(n) },
            class: Class::Status,
            remaining: Ticks(60_000 + 20_000 * u64::from(n)),
        };
        let port = |i: u16| {
            let queue: Vec<_> = if i.is_multiple_of(7) { (0..6).map(entry).collect() } else { Vec::new() };
            PortView {
                port: PortId(i),
                usage: Usage::Receive,
                class: Class::Status,
                len: u16::try_from(queue.len()).unwrap_or(0),
                capacity: 8,
                min_slack: queue.first().map(|e| e.remaining),
                queue,
                counters: PortCounters { enqueued: u64::from(i), ..PortCounters::default() },
            }
        };
        let first = node * self.ports;
        let view = TaskView {
            task: TaskId(node),
            state: TaskState::Running,
            ports: (first..first + self.ports).map(port).collect(),
            meetings: Vec::new(),
        };
        Snapshot {
            mono_us: 9_000_000,
            uptime_us: 8_000_000,
            tasks: vec![TaskSnapshot { liveness: Liveness::Alive, age_us: 0, view }],
            ..Snapshot::default()
        }
    }

    /// Messages that were sent and taken.
    #[must_use]
    pub fn events(&self, node: u16) -> Events {
        let to = (node + self.nodes - 1) % self.nodes;
        let event = |n: u16| {
            let (event, port, peer) = if n.is_multiple_of(2) {
                (Event::Sent, to * self.ports, TaskId(to))
            } else {
                (Event::Delivered, node * self.ports, self.sender(node))
            };
            let number = u32::from(n / 2);
            let what = Observation { event, port: PortId(port), peer, number, remaining: Ticks(150_000) };
            TimedEvent { mono_us: 8_900_000 + 500 * u64::from(n), task: Some(TaskId(node)), what }
        };
        Events { lost: 0, events: (0..20).map(event).collect() }
    }
}
