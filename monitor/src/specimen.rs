//! A synthetic cell of any size, in the form of the frames that its nodes would send. Benchmarks of the screens use it.

mod shown;

pub use shown::Shown;

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

/// The size of the cell. Its nodes form a ring. Each node has tasks, and each task has ports on which the same task of
/// the next node sends.
#[derive(Clone, Copy, Debug)]
pub struct Specimen {
    /// The number of nodes.
    pub nodes: u16,
    /// The number of tasks per node.
    pub tasks: u16,
    /// The number of ports at which each task receives.
    pub ports: u16,
    /// How many queued messages of a port are listed. A monitor of very many ports asks for none.
    pub queue_limit: u16,
}

/// How many messages are queued at every seventh port.
const WAITING: u16 = 6;

impl Specimen {
    /// A cell of 100 nodes with 100 ports each. All queued messages are listed.
    pub const CELL: Self = Self { nodes: 100, tasks: 1, ports: 100, queue_limit: WAITING };
    /// A cell of one node with 100 tasks of 100 ports each. No queued messages are listed.
    pub const NODE: Self = Self { nodes: 1, tasks: 100, ports: 100, queue_limit: 0 };

    /// The arrivals when a monitor attaches at the moment `at`: the state of each node with its queued messages, and 20
    /// events of each node.
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
        let said = |frame| Self::said(node, at, frame);
        vec![
            Arrival { at, source: SourceId(node.into()), feed: attached },
            said(ServerFrame::Table(self.table())),
            said(ServerFrame::Snapshot(self.snapshot(node))),
            said(ServerFrame::Events(self.events(node))),
        ]
    }

    /// Turns a frame of a node into an arrival.
    #[must_use]
    pub fn said(node: u16, at: Moment, frame: ServerFrame) -> Arrival {
        Arrival { at, source: SourceId(node.into()), feed: Feed::Frame(Box::new(frame)) }
    }

    /// The task that sends to `task`: the task of the same number within the next node.
    const fn sender(&self, task: u16) -> TaskId {
        TaskId((task + self.tasks) % (self.nodes * self.tasks))
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
        let tasks = self.nodes * self.tasks;
        let task = |i: u16| TaskName { name: format!("task{i}"), node: NodeId(i / self.tasks) };
        Table {
            cell: "specimen".into(),
            tick: Ticks(1_000),
            nodes: (0..self.nodes).map(|i| NodeName { name: format!("node{i}") }).collect(),
            links: (0..self.nodes).map(link).collect(),
            tasks: (0..tasks).map(task).collect(),
            ports: (0..tasks * self.ports).map(port).collect(),
        }
    }

    /// The state of a node.
    #[must_use]
    pub fn snapshot(&self, node: u16) -> Snapshot {
        let first = node * self.tasks;
        Snapshot {
            mono_us: 9_000_000,
            uptime_us: 8_000_000,
            tasks: (first..first + self.tasks).map(|task| self.task(task)).collect(),
            ..Snapshot::default()
        }
    }

    fn task(&self, task: u16) -> TaskSnapshot {
        let left = |n: u16| Ticks(60_000 + 20_000 * u64::from(n));
        let entry = |n: u16| QueueEntry {
            source: self.sender(task),
            id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(n.into()) },
            class: Class::Status,
            remaining: left(n),
        };
        let port = |i: u16| {
            let waiting = if i.is_multiple_of(7) { WAITING } else { 0 };
            PortView {
                port: PortId(i),
                usage: Usage::Receive,
                class: Class::Status,
                len: waiting,
                capacity: 8,
                min_slack: (waiting > 0).then(|| left(0)),
                queue: (0..waiting.min(self.queue_limit)).map(entry).collect(),
                counters: PortCounters { enqueued: 9_120, delivered: 9_041, ..PortCounters::default() },
            }
        };
        let first = task * self.ports;
        let view = TaskView {
            task: TaskId(task),
            state: TaskState::Running,
            ports: (first..first + self.ports).map(port).collect(),
            meetings: Vec::new(),
        };
        TaskSnapshot { liveness: Liveness::Alive, age_us: 0, view }
    }

    /// Advances a state by 100 ms. In each task one of `apart` ports changes, in rotation.
    pub fn go_on(state: &mut Snapshot, period: u64, apart: usize) {
        const PERIOD_US: u64 = 100_000;
        state.mono_us += PERIOD_US;
        state.uptime_us += PERIOD_US;
        let turn = usize::try_from(period).unwrap_or(0);
        for (t, task) in state.tasks.iter_mut().enumerate() {
            for (i, port) in task.view.ports.iter_mut().enumerate() {
                port.min_slack = port.min_slack.map(|left| left - Ticks(PERIOD_US));
                if (i + turn).is_multiple_of(apart) {
                    let mixed = (period * 31 + i as u64 * 7 + t as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                    let draw = mixed >> 33;
                    port.counters.enqueued += 20;
                    port.counters.delivered += 20;
                    port.len = u16::try_from(draw % 8).unwrap_or(0);
                    port.min_slack = Some(Ticks(draw % 200_000));
                }
            }
        }
    }

    /// Events of messages that the first task of a node sent and received.
    #[must_use]
    pub fn events(&self, node: u16) -> Events {
        let own = node * self.tasks;
        let all = self.nodes * self.tasks;
        let to = (own + all - self.tasks % all) % all;
        let event = |n: u16| {
            let (event, port, peer) = if n.is_multiple_of(2) {
                (Event::Sent, to * self.ports, TaskId(to))
            } else {
                (Event::Delivered, own * self.ports, self.sender(own))
            };
            let number = u32::from(n / 2);
            let what = Observation { event, port: PortId(port), peer, number, remaining: Ticks(150_000) };
            TimedEvent { mono_us: 8_900_000 + 500 * u64::from(n), task: Some(TaskId(own)), what }
        };
        Events { lost: 0, events: (0..20).map(event).collect() }
    }
}
