//! The frames that follow the handshake, in both directions.

use super::decode::{DecodeError, whole};
use super::delta::Delta;
use super::framing::FrameError;
use super::links::LinkReports;
use super::snapshot::Snapshot;
use super::told::{Denied, Detail, HeldBack, Places, Pong, Vitals};
use super::version::Version;
use super::want::{Challenge, Ping, Proof, Token, Want};
use imrs_protocol::{CellTable, Class, NodeId, Observation, TaskId, Ticks, Usage};
use serde::{Deserialize, Serialize};

/// A node of the cell; [`NodeId`] is the position in [`Table::nodes`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeName {
    /// The node's name.
    pub name: String,
}

/// A declared link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkName {
    /// The node at one end of the link.
    pub a: NodeId,
    /// The node at the other end of the link.
    pub b: NodeId,
    /// The declared upper bound of the link delay.
    pub delay: Ticks,
}

/// A task; [`TaskId`] is the position in [`Table::tasks`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskName {
    /// The task's name.
    pub name: String,
    /// The node on which the task runs.
    pub node: NodeId,
}

/// A task that has a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartyName {
    /// The id of the task.
    pub task: TaskId,
    /// The task's use of the port.
    pub usage: Usage,
    /// The task's time_out.
    pub time_out: Ticks,
}

/// A port; [`PortId`](imrs_protocol::PortId) is the position in [`Table::ports`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortName {
    /// The port's name.
    pub name: String,
    /// The port's class.
    pub class: Class,
    /// The value of `bounded_buffer`: how many messages the port's buffer holds.
    pub capacity: u16,
    /// The margin of a `waitfor`: the time that every member must have left at a release. Zero on other ports.
    pub margin: Ticks,
    /// The tasks that have the port: the owner first, then the users; of a `waitfor`, all members.
    pub parties: Vec<PartyName>,
}

/// The names and declared bounds of the whole cell. The node sends it once, before any frame that refers to it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Table {
    /// The name of the cell.
    pub cell: String,
    /// The tick of the cell: the declared lateness of timers.
    pub tick: Ticks,
    /// The nodes of the cell.
    pub nodes: Vec<NodeName>,
    /// The links of the cell.
    pub links: Vec<LinkName>,
    /// The tasks of the cell.
    pub tasks: Vec<TaskName>,
    /// The ports of the cell.
    pub ports: Vec<PortName>,
}

impl Table {
    /// The part of `table` that a monitor needs.
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

/// An observation of a communication task or of the transit buffer, with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimedEvent {
    /// The node's monotonic clock at the event, in microseconds.
    pub mono_us: u64,
    /// The task; `None` for the transit buffer.
    pub task: Option<TaskId>,
    /// The observed event.
    pub what: Observation,
}

/// The events since the previous frame of this kind, oldest first for each task.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Events {
    /// How many further events the node had to drop.
    pub lost: u64,
    /// The events that were kept.
    pub events: Vec<TimedEvent>,
}

/// Why a node closes a connection with a [`Bye`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goodbye {
    /// The node stops.
    Stopping,
    /// The monitor sent bytes that are not a [`ClientFrame`].
    Misunderstood,
}

/// The last frame before the node closes a connection itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bye {
    /// Why the node closes the connection.
    pub reason: Goodbye,
}

/// A frame from a node to a monitor, after the handshake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ServerFrame {
    /// The names and bounds of the cell. Sent once.
    Table(Table),
    /// The whole state of the node.
    Snapshot(Snapshot),
    /// The events since the previous frame of this kind.
    Events(Events),
    /// The node closes the connection.
    Bye(Bye),
    /// The changes since the previous snapshot or delta (1.1).
    Delta(Delta),
    /// The queues of the watched ports (1.1).
    Detail(Detail),
    /// Metrics of the node's process (1.1).
    Vitals(Vitals),
    /// The answer to a ping (1.1).
    Pong(Pong),
    /// The addresses of the other nodes (1.1).
    Places(Places),
    /// The node denies access, and closes the connection after this frame (1.1).
    Denied(Denied),
    /// The scripts of a restarted node that have not begun yet (1.2).
    HeldBack(HeldBack),
    /// The node requires a token, and the monitor must prove that it has the token (1.3).
    Challenge(Challenge),
    /// How long datagrams took on the node's links, and how many were damaged (1.4).
    Links(LinkReports),
}

impl ServerFrame {
    /// The bytes of the frame, for [`push_bytes`](super::FrameWriter::push_bytes): encoded once, and sent to several monitors.
    ///
    /// # Errors
    /// [`FrameError::Encode`].
    pub fn encode(&self) -> Result<Vec<u8>, FrameError> {
        postcard::to_extend(self, Vec::with_capacity(4096)).map_err(FrameError::Encode)
    }

    /// The first protocol version with this kind of frame.
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
            Self::Challenge(_) => 3,
            Self::Links(_) => 4,
        };
        Version { major: 1, minor }
    }

    /// Whether the frame costs a credit.
    #[must_use]
    pub const fn costs(&self) -> bool {
        match self {
            Self::Snapshot(_)
            | Self::Events(_)
            | Self::Delta(_)
            | Self::Detail(_)
            | Self::Vitals(_)
            | Self::Links(_) => true,
            Self::Table(_)
            | Self::Bye(_)
            | Self::Pong(_)
            | Self::Places(_)
            | Self::Denied(_)
            | Self::HeldBack(_)
            | Self::Challenge(_) => false,
        }
    }

    /// Decodes a frame.
    ///
    /// # Errors
    /// [`DecodeError`]. After [`DecodeError::UnknownKind`] the next frame can still be read.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        whole(bytes, 13)
    }
}

/// A monitor's subscription, as of version 1.0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subscribe {
    /// Microseconds between snapshots. A node may take longer; values below 10 ms count as 10 ms.
    pub period_us: u32,
    /// How many queued messages of each port a snapshot lists; at most 64.
    pub queue_limit: u8,
    /// Whether the node sends events.
    pub events: bool,
    /// How many frames the node may send before it needs a [`ClientFrame::Credit`].
    pub credit: u16,
}

/// A frame from a monitor to a node, after the handshake. No frame can change the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClientFrame {
    /// Starts the snapshots, or changes the subscription. The subscription's credit replaces the remaining credit.
    Subscribe(Subscribe),
    /// The node may send this many more frames. The sum saturates.
    Credit(u16),
    /// Starts or changes a subscription (1.1). The subscription's credit replaces the remaining credit. The deltas do not
    /// restart: the next delta continues from the last snapshot sent, if that snapshot listed as many messages per port.
    Want(Want),
    /// Asks for the node's clock (1.1).
    Ping(Ping),
    /// The token itself (1.1). Since 1.3 no node accepts this frame, and no monitor sends it, because others could read
    /// the token on the network.
    Token(Token),
    /// Asks for a whole snapshot instead of the next delta (1.1).
    Whole,
    /// Answers a [`ServerFrame::Challenge`] (1.3). Sent before any other frame.
    Proof(Proof),
}

impl ClientFrame {
    /// Decodes a frame.
    ///
    /// # Errors
    /// [`DecodeError`].
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        whole(bytes, 7)
    }
}
