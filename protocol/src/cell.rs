//! Declarations of a cell: nodes, links, tasks and ports with every option of Figures 1 and 2. Programs and the cell
//! language pass them to [`CellTable::new`](crate::table::CellTable::new).

mod error;

pub use error::CellError;

use crate::ids::{NodeId, PortId, TaskId};
use crate::packet::Class;
use crate::rules::Rules;
use crate::ticks::Ticks;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use serde::{Deserialize, Serialize};

/// What a task does at its end of a port (Figure 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Usage {
    /// The task sends messages.
    Send,
    /// The task receives messages.
    Receive,
    /// The task serves replies of third parties.
    Reply,
    /// The task asks questions, which may interrupt their targets.
    Query,
    /// The task answers queries.
    Response,
    /// The task takes part in a rendezvous.
    Waitfor,
}

impl Usage {
    /// The usage of the users of a port if this is the usage of its owner (D11).
    #[must_use]
    pub const fn counterpart(self) -> Self {
        match self {
            Self::Send | Self::Reply => Self::Receive,
            Self::Receive => Self::Send,
            Self::Query => Self::Response,
            Self::Response => Self::Query,
            Self::Waitfor => Self::Waitfor,
        }
    }

    /// The paper's word for this usage.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Send => "send",
            Self::Receive => "receive",
            Self::Reply => "reply",
            Self::Query => "query",
            Self::Response => "response",
            Self::Waitfor => "waitfor",
        }
    }
}

impl fmt::Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A node of the cell.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeDecl {
    /// The node's name, unique in the cell.
    pub name: String,
}

/// A link between two nodes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkDecl {
    /// The node at one end.
    pub a: NodeId,
    /// The node at the other end.
    pub b: NodeId,
    /// The bound of the link delay: the longest time that a packet takes unless it is lost (D20).
    pub delay: Ticks,
}

/// A task of the cell, and the node on which it runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskDecl {
    /// The task's name, unique in the cell.
    pub name: String,
    /// The node to which the task is assigned (§5.1).
    pub node: NodeId,
    /// The module to which the task belongs (§2). A `user_list` may name the module (D32).
    pub module: Option<String>,
}

/// Two work-coupled tasks (§2, D30, D61): if the task that holds the lease fails, the other one takes over.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoupleDecl {
    /// The task that acts first. It owns the `via` port with usage `response`, or uses it with that usage.
    pub primary: TaskId,
    /// The task that takes over. It sends the heartbeats, as queries on the `via` port.
    pub standby: TaskId,
    /// How long the primary may act after sending an answer that the standby has since echoed.
    pub lease: Ticks,
    /// How long the standby waits after the last answer that it received before it takes over.
    pub takeover: Ticks,
    /// The period of the heartbeats.
    pub every: Ticks,
    /// The port that carries the heartbeats.
    pub via: PortId,
    /// Whether `takeover` is accepted without a check: for checkers, which search for the smallest sound value.
    pub trusted: bool,
    /// Whether the roles are exchanged at a take-over (`<->`), so that the former primary becomes the standby.
    pub mutual: bool,
}

/// The time penalty of a port (§5.1.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Penalty {
    /// How long a rejected message waits until it is offered again.
    pub length: Ticks,
    /// Whether the literal rule holds: the penalty is added to the message's time_out (Appendix, `save`; D4).
    pub literal: bool,
}

/// The highest rate of messages: at most this many in each period (D53).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rate {
    /// The number of messages in each period.
    pub count: u16,
    /// The time in which at most that many messages are sent.
    pub per: Ticks,
}

/// One user of a port: `use_port` of Figure 1.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UserDecl {
    /// The using task.
    pub task: TaskId,
    /// The user's own time_out, where it differs from the owner's.
    pub time_out: Option<Ticks>,
    /// `class`, which must be the owner's (D9).
    pub class: Option<Class>,
    /// `message_format`, which must be the owner's (D9).
    pub format: Option<String>,
    /// How often the user's own class-2 messages are retransmitted, where that differs from the owner's number.
    pub retry: Option<u8>,
    /// The highest rate at which the user sends, where that differs from the owner's rate.
    pub rate: Option<Rate>,
}

impl UserDecl {
    /// A user with the owner's value for every option.
    #[must_use]
    pub const fn new(task: TaskId) -> Self {
        Self { task, time_out: None, class: None, format: None, retry: None, rate: None }
    }
}

/// A port: `port` of Figure 1 with its options.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortDecl {
    /// The port's name, unique in the cell.
    pub name: String,
    /// The owning task.
    pub owner: TaskId,
    /// The owner's usage; the users have its [`Usage::counterpart`].
    pub usage: Usage,
    /// `user_list`: the tasks that it names.
    pub users: Vec<UserDecl>,
    /// `user_list`: the modules that it names. Each module adds all its tasks except the owner to the users (D32).
    pub modules: Vec<String>,
    /// `time_out`: the TTL of a message, which is also its priority and the time that its sender waits (§III).
    pub time_out: Ticks,
    /// `class`: whether senders wait for answers.
    pub class: Class,
    /// `bounded_buffer[n]`: how many messages wait for one receiver.
    pub bounded_buffer: u16,
    /// `message_format`: a description that both ends must agree on; part of the port's hash.
    pub format: String,
    /// How often a class-2 message is retransmitted within its time_out (D5).
    pub retry: u8,
    /// The period of retransmission: of class-2 messages with `retry`, and of ARRIVE and CONFIRM (D55).
    pub resend: Ticks,
    /// How many lost packets of one meeting the margin of a `waitfor` covers (D2, D55).
    pub losses: u8,
    /// The margin of a `waitfor`; `None` takes the closed form (D56).
    pub margin: Option<Ticks>,
    /// `penalty`: how long a rejected message waits until it is offered again.
    pub penalty: Option<Penalty>,
    /// `latest`: a message replaces a waiting one of the same source.
    pub latest: bool,
    /// How many packets a message takes (D28).
    pub fragments: u8,
    /// How many packets an answer takes (D28).
    pub answer_fragments: u8,
    /// `rate`: the highest rate at which messages are sent.
    pub rate: Option<Rate>,
    /// The position of the couple (primary and standby) whose lease guards this port: receivers drop messages of an older lease
    /// (D61).
    pub guard: Option<u8>,
}

impl PortDecl {
    /// A port with defaults for the other options: class 1 if the usage allows it, `bounded_buffer[1]`, no retransmission.
    #[must_use]
    pub fn new(name: &str, owner: TaskId, usage: Usage, users: &[TaskId], time_out: Ticks) -> Self {
        Self {
            name: name.into(),
            owner,
            usage,
            users: users.iter().copied().map(UserDecl::new).collect(),
            time_out,
            class: match usage {
                Usage::Waitfor | Usage::Query | Usage::Response | Usage::Reply => Class::Command,
                Usage::Send | Usage::Receive => Class::Status,
            },
            modules: Vec::new(),
            bounded_buffer: 1,
            format: String::new(),
            retry: 0,
            resend: Ticks::FAR,
            losses: 0,
            margin: None,
            penalty: None,
            latest: false,
            fragments: 1,
            answer_fragments: 1,
            rate: None,
            guard: None,
        }
    }

    /// Whether a penalty extends the deadline of the message: the literal rule (Appendix, `save`; D4).
    pub(crate) fn lengthens_ttls(&self) -> bool {
        self.penalty.is_some_and(|penalty| penalty.literal)
    }

    /// Whether every message and every answer takes one packet (D28).
    pub(crate) fn takes_one_packet(&self) -> bool {
        self.fragments <= 1 && self.answer_fragments <= 1
    }

    /// Makes this a class-2 port: its sender waits for the answer.
    #[must_use]
    pub fn command(mut self) -> Self {
        self.class = Class::Command;
        self
    }

    /// Sets `bounded_buffer[n]`.
    #[must_use]
    pub fn bounded_buffer(mut self, n: u16) -> Self {
        self.bounded_buffer = n;
        self
    }

    /// Sets how often, and at which interval, a class-2 message is retransmitted.
    #[must_use]
    pub fn retry(mut self, times: u8, every: Ticks) -> Self {
        self.retry = times;
        self.resend = every;
        self
    }

    /// Sets the retransmission period of a `waitfor` and how many losses its margin covers.
    #[must_use]
    pub fn resend(mut self, every: Ticks, losses: u8) -> Self {
        self.resend = every;
        self.losses = losses;
        self
    }

    /// Sets the time penalty of rejected messages (§5.1.1).
    #[must_use]
    pub fn penalty(mut self, length: Ticks) -> Self {
        self.penalty = Some(Penalty { length, literal: false });
        self
    }

    /// Lets a message replace a waiting one of the same source.
    #[must_use]
    pub fn latest(mut self) -> Self {
        self.latest = true;
        self
    }

    /// Sets how many packets a message and an answer take (D28).
    #[must_use]
    pub fn fragments(mut self, message: u8, answer: u8) -> Self {
        (self.fragments, self.answer_fragments) = (message, answer);
        self
    }

    /// Adds the tasks of a module to the users (D32).
    #[must_use]
    pub fn module(mut self, module: &str) -> Self {
        self.modules.push(module.into());
        self
    }

    /// Sets the highest rate at which messages are sent (D53).
    #[must_use]
    pub fn rate(mut self, count: u16, per: Ticks) -> Self {
        self.rate = Some(Rate { count, per });
        self
    }

    /// Sets the couple whose lease guards the port (D61).
    #[must_use]
    pub fn guard(mut self, couple: u8) -> Self {
        self.guard = Some(couple);
        self
    }

    /// Sets the description of the message format.
    #[must_use]
    pub fn format(mut self, description: &str) -> Self {
        self.format = description.into();
        self
    }
}

/// A whole cell, as declared.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cell {
    /// The cell's name.
    pub name: String,
    /// The declared timer lateness: a node acts on a time_out at most this late (D42).
    pub tick: Ticks,
    /// The nodes; [`NodeId`] is the position in this list.
    pub nodes: Vec<NodeDecl>,
    /// The links of the cell.
    pub links: Vec<LinkDecl>,
    /// The tasks; [`TaskId`] is the position in this list.
    pub tasks: Vec<TaskDecl>,
    /// The ports; [`PortId`] is the position in this list.
    pub ports: Vec<PortDecl>,
    /// The work-coupled pairs.
    pub couples: Vec<CoupleDecl>,
    /// The variants of the rules; a real cell runs the default.
    pub rules: Rules,
}

impl Cell {
    /// An empty cell.
    #[must_use]
    pub fn new(name: &str, tick: Ticks) -> Self {
        Self { name: name.into(), tick, ..Self::default() }
    }

    /// Adds a node.
    pub fn node(&mut self, name: &str) -> NodeId {
        self.nodes.push(NodeDecl { name: name.into() });
        NodeId::from_index(self.nodes.len() - 1)
    }

    /// Adds a link whose packets take at most `delay`.
    pub fn link(&mut self, a: NodeId, b: NodeId, delay: Ticks) {
        self.links.push(LinkDecl { a, b, delay });
    }

    /// Adds a task on a node.
    pub fn task(&mut self, name: &str, node: NodeId) -> TaskId {
        self.tasks.push(TaskDecl { name: name.into(), node, module: None });
        TaskId::from_index(self.tasks.len() - 1)
    }

    /// Adds a port.
    pub fn port(&mut self, port: PortDecl) -> PortId {
        self.ports.push(port);
        PortId::from_index(self.ports.len() - 1)
    }
}

/// The most nodes of a cell. The routing table has an entry for each pair of nodes, and the time to compute it grows with
/// the cube of their number (D151).
pub const MAX_NODES: usize = 512;

/// The most tasks that one `waitfor` joins.
pub const MAX_MEMBERS: usize = 64;

/// The most packets that one message or answer takes (D28).
pub const MAX_FRAGMENTS: u8 = 16;
