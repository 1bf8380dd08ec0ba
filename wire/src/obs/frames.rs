//! What is said after the handshake.

use super::decode::{DecodeError, whole};
use super::delta::Delta;
use super::snapshot::Snapshot;
use super::told::{Denied, Detail, HeldBack, Places, Pong, Vitals};
use super::version::Version;
use super::want::{Ping, Token, Want};
use imrs_protocol::{CellTable, Class, NodeId, Observation, TaskId, Ticks, Usage};
use serde::{Deserialize, Serialize};

/// A node of the cell; [`NodeId`] is the position in [`Table::nodes`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeName {
    /// Its name.
    pub name: String,
}

/// A declared link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkName {
    /// One end.
    pub a: NodeId,
    /// The other end.
    pub b: NodeId,
    /// The declared bound of its delay (D20).
    pub delay: Ticks,
}

/// A task; [`TaskId`] is the position in [`Table::tasks`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskName {
    /// Its name.
    pub name: String,
    /// Where it runs.
    pub node: NodeId,
}

/// One end of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartyName {
    /// The task.
    pub task: TaskId,
    /// What it does with the port.
    pub usage: Usage,
    /// Its time_out.
    pub time_out: Ticks,
}

/// A port; [`PortId`](imrs_protocol::PortId) is the position in [`Table::ports`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortName {
    /// Its name.
    pub name: String,
    /// Its class.
    pub class: Class,
    /// `bounded_buffer`.
    pub capacity: u16,
    /// The margin of a `waitfor` (D2); zero on other ports.
    pub margin: Ticks,
    /// Owner first, then the users; of a `waitfor`, all members.
    pub parties: Vec<PartyName>,
}

/// The names and declared bounds of the whole cell. Sent once, before anything refers to it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Table {
    /// The name of the cell.
    pub cell: String,
    /// The declared lateness of timers.
    pub tick: Ticks,
    /// The nodes.
    pub nodes: Vec<NodeName>,
    /// The links.
    pub links: Vec<LinkName>,
    /// The tasks.
    pub tasks: Vec<TaskName>,
    /// The ports.
    pub ports: Vec<PortName>,
}

impl Table {
    /// What a monitor needs to know of `table`.
    #[must_use]
    pub fn of(table: &CellTable) -> Self {
        let cell = table.cell();
        let port = |port: &imrs_protocol::Port| PortName {
            name: port.decl.name.clone(),
            class: port.decl.class,
            capacity: port.decl.bounded_buffer,
            margin: port.margin,
            parties: (port.parties.iter())
                .map(|p| PartyName { task: p.task, usage: p.usage, time_out: p.time_out })
                .collect(),
        };
        Self {
            cell: cell.name.clone(),
            tick: cell.tick,
            nodes: cell.nodes.iter().map(|n| NodeName { name: n.name.clone() }).collect(),
            links: cell.links.iter().map(|l| LinkName { a: l.a, b: l.b, delay: l.delay }).collect(),
            tasks: cell.tasks.iter().map(|t| TaskName { name: t.name.clone(), node: t.node }).collect(),
            ports: table.ports().iter().map(port).collect(),
        }
    }
}

/// Something that happened, as a communication task or the transit buffer observed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimedEvent {
    /// The node's monotonic clock then, in microseconds.
    pub mono_us: u64,
    /// Where: a task, or `None` for the transit buffer.
    pub task: Option<TaskId>,
    /// What.
    pub what: Observation,
}

/// What happened since the last such frame, oldest first for each task.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Events {
    /// How many more happened and could not be kept.
    pub lost: u64,
    /// Those that were kept.
    pub events: Vec<TimedEvent>,
}

/// Why a node ends a connection in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goodbye {
    /// The node stops.
    Stopping,
    /// The monitor sent something that is no [`ClientFrame`].
    Misunderstood,
}

/// The last frame of a connection that ends in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bye {
    /// Why.
    pub reason: Goodbye,
}

/// What a node says after the handshake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ServerFrame {
    /// The cell, once.
    Table(Table),
    /// The state of the node.
    Snapshot(Snapshot),
    /// What happened.
    Events(Events),
    /// The end.
    Bye(Bye),
    /// What changed since the last snapshot or change (1.1).
    Delta(Delta),
    /// What waits at the ports that are watched (1.1).
    Detail(Detail),
    /// How the process does (1.1).
    Vitals(Vitals),
    /// The answer to a ping (1.1).
    Pong(Pong),
    /// Where the other nodes are (1.1).
    Places(Places),
    /// The node does not show itself; the connection is closed after this (1.1).
    Denied(Denied),
    /// Which scripts of a restarted node have not begun yet (1.2).
    HeldBack(HeldBack),
}

impl ServerFrame {
    /// The first version that has this kind of frame.
    #[must_use]
    pub const fn since(&self) -> Version {
        let minor = match self {
            Self::Table(_) | Self::Snapshot(_) | Self::Events(_) | Self::Bye(_) => 0,
            Self::Delta(_)
            | Self::Detail(_)
            | Self::Vitals(_)
            | Self::Pong(_)
            | Self::Places(_)
            | Self::Denied(_) => 1,
            Self::HeldBack(_) => 2,
        };
        Version { major: 1, minor }
    }

    /// Whether it costs a credit.
    #[must_use]
    pub const fn costs(&self) -> bool {
        match self {
            Self::Snapshot(_) | Self::Events(_) | Self::Delta(_) | Self::Detail(_) | Self::Vitals(_) => true,
            Self::Table(_)
            | Self::Bye(_)
            | Self::Pong(_)
            | Self::Places(_)
            | Self::Denied(_)
            | Self::HeldBack(_) => false,
        }
    }

    /// The frame that `bytes` are.
    ///
    /// # Errors
    /// [`DecodeError`]; after [`DecodeError::UnknownKind`] the next frame can still be read.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        whole(bytes, 11)
    }
}

/// How much a monitor wants to see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subscribe {
    /// Microseconds between snapshots. A node may take longer; it never takes less than 10 ms.
    pub period_us: u32,
    /// How many waiting messages of each port a snapshot lists; at most 64 are.
    pub queue_limit: u8,
    /// Whether events are wanted.
    pub events: bool,
    /// How many frames the node may send before it needs a [`ClientFrame::Credit`].
    pub credit: u16,
}

/// What a monitor says after the handshake. Nothing here can change a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClientFrame {
    /// Begins the snapshots, or changes what is wanted from now on. The credit replaces what was left.
    Subscribe(Subscribe),
    /// The node may send so many frames more. The sum saturates.
    Credit(u16),
    /// Begins what is wanted, or changes it from now on (1.1). The credit replaces what was left. It does not begin
    /// anew: what changed goes on from what was sent last, if that had as many messages per port.
    Want(Want),
    /// Asks for the node's clock (1.1).
    Ping(Ping),
    /// Shows that the monitor may look (1.1). Before anything else is said.
    Token(Token),
    /// Asks for a whole snapshot in place of the next change (1.1).
    Whole,
}

impl ClientFrame {
    /// The frame that `bytes` are.
    ///
    /// # Errors
    /// [`DecodeError`].
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        whole(bytes, 6)
    }
}
