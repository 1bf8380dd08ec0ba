//! What a cell declares: nodes, links, tasks and ports with every option of Figures 1 and 2. This is the form that
//! programs and the cell language hand to [`CellTable::new`](crate::table::CellTable::new).

use crate::ids::{NodeId, TaskId};
use crate::packet::Class;
use crate::rules::Rules;
use crate::ticks::Ticks;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use serde::{Deserialize, Serialize};

/// The verb that a port is for at one of its ends (Figure 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Usage {
    /// Sends messages.
    Send,
    /// Receives messages.
    Receive,
    /// Serves replies to third parties.
    Reply,
    /// Asks, interrupting its target.
    Query,
    /// Answers queries.
    Response,
    /// Takes part in a rendezvous.
    Waitfor,
}

impl Usage {
    /// The usage a user of a port must have for the owner's to make sense (D11).
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

    /// The paper's word.
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
    /// Its name, unique in the cell.
    pub name: String,
}

/// A link between two nodes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkDecl {
    /// One end.
    pub a: NodeId,
    /// The other end.
    pub b: NodeId,
    /// The longest time a packet takes that is not lost (D20).
    pub delay: Ticks,
}

/// A task of the cell and where it runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskDecl {
    /// Its name, unique in the cell.
    pub name: String,
    /// The node it is assigned to (§5.1).
    pub node: NodeId,
}

/// One user of a port: `use_port` of Figure 1.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UserDecl {
    /// The using task.
    pub task: TaskId,
    /// Its own time_out, where it differs from the owner's.
    pub time_out: Option<Ticks>,
}

/// A port: `port` of Figure 1 with its options.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortDecl {
    /// Its name, unique in the cell.
    pub name: String,
    /// The owning task.
    pub owner: TaskId,
    /// The owner's usage; the users have its [`Usage::counterpart`].
    pub usage: Usage,
    /// `user_list`.
    pub users: Vec<UserDecl>,
    /// `time_out`: priority, patience and life of a message in one (§III).
    pub time_out: Ticks,
    /// `class`.
    pub class: Class,
    /// `bounded_buffer[n]`: how many messages wait for one receiver.
    pub bounded_buffer: u16,
    /// `message_format`: a description that both ends must agree on; part of the port's hash.
    pub format: String,
    /// How often a class-2 message is sent again within its one time_out (D5).
    pub retry: u8,
    /// The period of re-sending: of class-2 messages with `retry`, and of ARRIVE and CONFIRM (D55).
    pub resend: Ticks,
    /// How many lost packets of one meeting the margin of a `waitfor` covers (D2, D55).
    pub losses: u8,
    /// The margin of a `waitfor`, where the closed form (D56) is not wanted.
    pub margin: Option<Ticks>,
}

impl PortDecl {
    /// A port with the given essentials: class 1, `bounded_buffer[1]`, no re-sending, no format.
    #[must_use]
    pub fn new(name: &str, owner: TaskId, usage: Usage, users: &[TaskId], time_out: Ticks) -> Self {
        Self {
            name: name.into(),
            owner,
            usage,
            users: users.iter().map(|&task| UserDecl { task, time_out: None }).collect(),
            time_out,
            class: if usage == Usage::Waitfor { Class::Command } else { Class::Status },
            bounded_buffer: 1,
            format: String::new(),
            retry: 0,
            resend: Ticks::FAR,
            losses: 0,
            margin: None,
        }
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

    /// Sets how often, and how long apart, a class-2 message is sent again.
    #[must_use]
    pub fn retry(mut self, times: u8, every: Ticks) -> Self {
        self.retry = times;
        self.resend = every;
        self
    }

    /// Sets the re-sending period of a `waitfor` and how many losses its margin covers.
    #[must_use]
    pub fn resend(mut self, every: Ticks, losses: u8) -> Self {
        self.resend = every;
        self.losses = losses;
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
    /// Its name.
    pub name: String,
    /// The declared lateness of timers: no node acts on a time_out later than this (D42).
    pub tick: Ticks,
    /// The nodes; [`NodeId`] is the position here.
    pub nodes: Vec<NodeDecl>,
    /// The links.
    pub links: Vec<LinkDecl>,
    /// The tasks; [`TaskId`] is the position here.
    pub tasks: Vec<TaskDecl>,
    /// The ports; [`PortId`](crate::PortId) is the position here.
    pub ports: Vec<PortDecl>,
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
        self.tasks.push(TaskDecl { name: name.into(), node });
        TaskId::from_index(self.tasks.len() - 1)
    }

    /// Adds a port.
    pub fn port(&mut self, port: PortDecl) -> crate::ids::PortId {
        self.ports.push(port);
        crate::ids::PortId::from_index(self.ports.len() - 1)
    }
}

/// What is wrong with a declared cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CellError {
    /// Two nodes, two tasks or two ports have the same name (R35).
    DuplicateName(&'static str, String),
    /// A declaration points at a node, task or link end that is not in the cell.
    Dangling(String),
    /// More than 65,536 of something.
    TooMany(&'static str),
    /// A link joins a node with itself.
    LinkToItself(String),
    /// A port without users.
    NoUsers(String),
    /// A port whose owner or a user is listed twice.
    ListedTwice(String, String),
    /// A `waitfor` of more than [`MAX_MEMBERS`] tasks.
    TooManyMembers(String),
    /// A buffer for no message.
    NoBuffer(String),
    /// A zero time_out.
    NoTimeOut(String),
    /// Class 1 has no answer: `waitfor`, `query` and `retry` need class 2.
    NeedsClass2(String),
    /// A usage that this version of the protocol does not carry out yet.
    Unsupported(String, Usage),
    /// Two tasks of a port run on nodes that no chain of at most 8 links joins.
    Unreachable(String, String, String),
    /// The time_out cannot cover the margin and the way: nobody could ever be released (D56).
    MarginTooLong {
        /// The port.
        port: String,
        /// Its (or its least patient user's) time_out.
        time_out: Ticks,
        /// What it must exceed.
        least: Ticks,
    },
    /// The time_out cannot cover the way there and back.
    DeadlineTooShort {
        /// The port.
        port: String,
        /// Its time_out.
        time_out: Ticks,
        /// What it must exceed.
        least: Ticks,
    },
}

/// The most tasks that one `waitfor` joins.
pub const MAX_MEMBERS: usize = 64;

impl fmt::Display for CellError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DuplicateName(what, name) => write!(f, "two {what} are called `{name}`: rename one"),
            Self::Dangling(what) => write!(f, "{what} names something that is not in the cell"),
            Self::TooMany(what) => write!(f, "more than 65,536 {what}: split the cell"),
            Self::LinkToItself(node) => write!(f, "a link joins `{node}` with itself: remove it"),
            Self::NoUsers(port) => write!(f, "port `{port}` has no users: name them in its user_list"),
            Self::ListedTwice(port, task) => write!(f, "port `{port}` lists `{task}` twice"),
            Self::TooManyMembers(port) => {
                write!(f, "waitfor `{port}` joins more than {MAX_MEMBERS} tasks: meet in groups")
            }
            Self::NoBuffer(port) => write!(f, "port `{port}` has bounded_buffer[0]: it needs at least 1"),
            Self::NoTimeOut(port) => write!(f, "port `{port}` has no time_out"),
            Self::NeedsClass2(port) => write!(f, "port `{port}` waits for an answer, so it must be class 2"),
            Self::Unsupported(port, usage) => {
                write!(f, "port `{port}`: usage `{usage}` is not carried out by this version")
            }
            Self::Unreachable(port, a, b) => {
                write!(
                    f,
                    "port `{port}` joins `{a}` and `{b}`, but no chain of at most 8 links joins their nodes"
                )
            }
            Self::MarginTooLong { port, time_out, least } => write!(
                f,
                "waitfor `{port}`: time_out {time_out} must exceed {least} ticks (safety margin and way), or nobody is ever released"
            ),
            Self::DeadlineTooShort { port, time_out, least } => {
                write!(
                    f,
                    "port `{port}`: time_out {time_out} must exceed {least} ticks (the way there and back)"
                )
            }
        }
    }
}

impl core::error::Error for CellError {}
