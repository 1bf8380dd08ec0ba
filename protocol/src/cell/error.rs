//! The faults of a declared cell, each with what to do about it.

use super::{MAX_FRAGMENTS, MAX_MEMBERS};
use crate::ticks::Ticks;
use alloc::string::String;
use core::fmt;

/// What is wrong with a declared cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CellError {
    /// Two nodes, two tasks or two ports have the same name (R35).
    DuplicateName(&'static str, String),
    /// A declaration points at a node, task or link end that is not in the cell.
    Dangling(String),
    /// There are more than 65,535 nodes, tasks, ports or the like.
    TooMany(&'static str, usize),
    /// A link joins a node with itself.
    LinkToItself(String),
    /// A port without users.
    NoUsers(String),
    /// A port whose owner or a user is listed twice.
    ListedTwice(String, String),
    /// A `waitfor` of more than [`MAX_MEMBERS`] tasks.
    TooManyMembers(String),
    /// A bounded buffer without room for a message.
    NoBuffer(String),
    /// The time_out of a port is zero.
    NoTimeOut(String),
    /// Class 1 has no answer: `waitfor`, `query` and `retry` need class 2.
    NeedsClass2(String),
    /// A `user_list` names a module that no task belongs to (D32).
    UnknownModule(String, String),
    /// A message or an answer that takes no packet, or more than [`MAX_FRAGMENTS`] (D28).
    Fragments(String, u8),
    /// A class-2 port whose owner asks more than [`MAX_MEMBERS`] - 1 tasks.
    TooManyAsked(String),
    /// A rate so high that sequence numbers could wrap within one TTL (D53).
    SequenceWraps(String),
    /// A rate that cannot be served: a class-2 message may block its sender for a round trip, however fast the receiver is
    /// (D53).
    CannotBeServed {
        /// The port with that rate.
        port: String,
        /// The period of the declared rate.
        per: Ticks,
        /// The shortest period that is allowed.
        least: Ticks,
    },
    /// A user declares another class than the owner (D9).
    OtherClass(String, String),
    /// A user declares another message_format than the owner (D9).
    OtherFormat(String, String),
    /// Two tasks of a port run on nodes that no chain of at most 8 links joins.
    Unreachable(String, String, String),
    /// The time_out cannot cover the margin and the link delays: no member could ever be released (D56).
    MarginTooLong {
        /// The port of the rendezvous.
        port: String,
        /// The smallest time_out of the rendezvous.
        time_out: Ticks,
        /// The value that the time_out must exceed.
        least: Ticks,
    },
    /// A couple's heartbeats need a port that joins only its two tasks: the standby queries, the primary responds.
    NotForHeartbeats(String),
    /// A task belongs to two couples.
    CoupledTwice(String),
    /// A port guarded by a lease has a sender outside the couple, or is a `waitfor`.
    NotOfTheCouple(String),
    /// A port guarded by a lease cannot carry the epoch: its messages take several packets, or it carries answers for others
    /// or the couple's own heartbeats (D61).
    NoRoomForEpoch(String),
    /// The lease ends before a heartbeat can renew it (D61).
    LeaseTooShort {
        /// The couple whose lease is too short.
        couple: String,
        /// The declared lease.
        lease: Ticks,
        /// The shortest lease that is allowed.
        least: Ticks,
    },
    /// The standby may take over while the primary still acts (D61).
    TakeoverTooSoon {
        /// The couple whose standby would take over too soon.
        couple: String,
        /// The declared time until the take-over.
        takeover: Ticks,
        /// The shortest time until the take-over that is allowed.
        least: Ticks,
    },
    /// The time_out cannot cover the link delays: to the peer and, for a class-2 message, back.
    DeadlineTooShort {
        /// The port whose deadline is too short.
        port: String,
        /// The port's time_out.
        time_out: Ticks,
        /// The value that the time_out must exceed.
        least: Ticks,
    },
}

impl fmt::Display for CellError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DuplicateName(what, name) => write!(f, "two {what} are called `{name}`: rename one"),
            Self::Dangling(what) => write!(f, "{what} names something that is not in the cell"),
            Self::TooMany(what, most) => write!(f, "more than {most} {what}: split the cell"),
            Self::LinkToItself(node) => write!(f, "a link joins `{node}` with itself: remove it"),
            Self::NoUsers(port) => write!(f, "port `{port}` has no users: name them in its user_list"),
            Self::ListedTwice(port, task) => write!(f, "port `{port}` lists `{task}` twice"),
            Self::TooManyMembers(port) => {
                write!(f, "waitfor `{port}` joins more than {MAX_MEMBERS} tasks: meet in groups")
            }
            Self::NoBuffer(port) => write!(f, "port `{port}` has bounded_buffer[0]: it needs at least 1"),
            Self::NoTimeOut(port) => write!(f, "port `{port}` has no time_out"),
            Self::NeedsClass2(port) => write!(f, "port `{port}` waits for an answer, so it must be class 2"),
            Self::UnknownModule(port, module) => {
                write!(f, "port `{port}` names module `{module}`, which no task belongs to")
            }
            Self::Fragments(port, n) => write!(
                f,
                "port `{port}`: a message of {n} packets: 1 to {MAX_FRAGMENTS} are possible; send a longer one in parts"
            ),
            Self::TooManyAsked(port) => {
                write!(f, "port `{port}` asks more than {} tasks at a time: ask in groups", MAX_MEMBERS - 1)
            }
            Self::SequenceWraps(port) => {
                write!(f, "port `{port}`: too many messages in one time_out: lower its rate or its time_out")
            }
            Self::CannotBeServed { port, per, least } => write!(
                f,
                "port `{port}`: its rate cannot be served: so many messages in {per} ticks block their sender for {least} (the links there and back each): lower its rate"
            ),
            Self::OtherClass(port, task) => {
                write!(f, "`{task}` uses port `{port}` with another class than its owner: leave it out")
            }
            Self::OtherFormat(port, task) => {
                write!(
                    f,
                    "`{task}` uses port `{port}` with another message_format than its owner: leave it out"
                )
            }
            Self::Unreachable(port, a, b) => {
                write!(
                    f,
                    "port `{port}` joins `{a}` and `{b}`, but no chain of at most 8 links joins their nodes"
                )
            }
            Self::MarginTooLong { port, time_out, least } => write!(
                f,
                "waitfor `{port}`: time_out {time_out} must exceed {least} ticks (the margin and the links), or no task is ever released"
            ),
            Self::NotForHeartbeats(port) => write!(
                f,
                "port `{port}` cannot carry heartbeats: it must join the two tasks of the couple alone, the standby with usage query, the primary with usage response"
            ),
            Self::CoupledTwice(couple) => {
                write!(f, "couple `{couple}`: one of its tasks is in another couple already")
            }
            Self::NotOfTheCouple(port) => write!(
                f,
                "port `{port}` acts under a couple's lease: only the two tasks of that couple may send on it, and it cannot be a waitfor"
            ),
            Self::NoRoomForEpoch(port) => write!(
                f,
                "port `{port}` acts under a couple's lease, and its epoch travels in messages of one packet only: not in several, in answers for others or in heartbeats"
            ),
            Self::LeaseTooShort { couple, lease, least } => write!(
                f,
                "couple `{couple}`: lease {lease} must be at least {least} ticks (two heartbeat periods, the link delay and a tick), or it ends before it is renewed"
            ),
            Self::TakeoverTooSoon { couple, takeover, least } => write!(
                f,
                "couple `{couple}`: takeover {takeover} must be at least {least} ticks (lease, drift, a tick and what was sent last), or both may act at a time"
            ),
            Self::DeadlineTooShort { port, time_out, least } => {
                write!(
                    f,
                    "port `{port}`: time_out {time_out} must exceed {least} ticks (the links that it passes)"
                )
            }
        }
    }
}

impl core::error::Error for CellError {}
