//! The ways in which the invariants of a communication task can be violated.

use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::request::TimeId;
use crate::ticks::Instant;
use core::fmt;

/// An invariant that is violated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Violation {
    /// A port's buffer holds more messages than its `bounded_buffer` (§5.1.1).
    Overfull(PortId),
    /// A buffer holds an expired message (§5.1.1).
    HoldsExpired(PortId, TaskId, MessageId),
    /// A buffer holds a message of a class or from a task that the port does not admit.
    HoldsForeign(PortId, TaskId, MessageId),
    /// A buffer holds a command, but no dedup entry says that this command waits: a copy of the command would run twice
    /// (D52).
    NotRemembered(PortId, TaskId, MessageId),
    /// A dedup entry is forgotten while the sender still waits, or the execution budget ends after the entry (D6, D18).
    MemoryTooShort(TaskId, MessageId),
    /// The task still waits after its deadline.
    Overdue(Instant),
    /// The task waits for an answer although no request is open, or a request is open although the task does not wait for
    /// an answer; or a request has the id of another task's message.
    WaitsForNothing(PortId),
    /// The task waits at a `waitfor` that has no deadline, or a `waitfor` has a deadline although the task does not wait
    /// there.
    MeetingAndWaitDiffer(PortId),
    /// A retransmission is due at an instant that the deadline does not imply, or without a reason (D5, D55).
    ResendInstant(PortId),
    /// A `waitfor` has released its task from a round that the task never announced, or has forgotten the freshest round of
    /// which it heard (D54).
    Rounds(PortId),
    /// A `waitfor` holds the arrival of a member in a round that this member gave up (D54).
    HoldsBarred(PortId, TaskId, Round),
    /// A `waitfor` owes a CONFIRM although it never released its task, or while it waits for the next meeting (D1).
    OwesConfirm(PortId),
    /// Too many handlers run, or a handler ranks lower than the activation that it interrupted, or an interrupted activation
    /// neither waits nor is between two statements (D15).
    Levels(u8),
    /// A message for a handler is due and was not offered, though the running activation can be interrupted (D15).
    NotOffered(PortId, TaskId, MessageId),
    /// A message was rejected more often than ranks stand above it, or was rejected although rejections do not count (D58).
    RejectedTooOften(PortId, TaskId, MessageId),
    /// A rejected message is not offered again when the port's penalty is over (D58).
    RejectedTooLong(PortId, TaskId, MessageId),
    /// Two timers or delays of the task have the same name.
    Timers(TimeId),
    /// A timer has ended and outranks an interruptible activation, but its handler has not begun (D15).
    TimerNotOffered(TimeId),
    /// An incomplete message has expired, or is held on a port whose messages take one packet (D28).
    HoldsFragments(PortId, TaskId),
    /// The task acts past its lease, or has not taken over in time (D61).
    PastLease(Instant),
    /// The lease has a pending call that no longer describes the present state.
    WrongCall,
    /// A heap disagrees with a scan of the entries that it orders.
    OutOfOrder(PortId),
    /// The cached next deadline disagrees with a scan of all parts.
    WrongDeadline,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Overfull(port) => write!(f, "port {port} holds more messages than its bounded_buffer"),
            Self::HoldsExpired(port, source, id) => {
                write!(f, "port {port} holds message {id} of {source}, which has no time left")
            }
            Self::HoldsForeign(port, source, id) => {
                write!(f, "port {port} holds message {id} of {source}, which it does not admit")
            }
            Self::NotRemembered(port, source, id) => {
                write!(f, "port {port} holds command {id} of {source}, but the memory does not say so")
            }
            Self::MemoryTooShort(source, id) => {
                write!(f, "the memory of command {id} of {source} ends before copies of it can")
            }
            Self::Overdue(deadline) => write!(f, "the task still waits after its deadline {deadline}"),
            Self::WaitsForNothing(port) => {
                write!(f, "the task waits for an answer that port {port} cannot give")
            }
            Self::MeetingAndWaitDiffer(port) => {
                write!(f, "the task and waitfor {port} do not agree whether it waits")
            }
            Self::ResendInstant(port) => {
                write!(f, "port {port} sends again at an instant that nothing asks for")
            }
            Self::Rounds(port) => write!(f, "the rounds of waitfor {port} contradict each other"),
            Self::HoldsBarred(port, member, round) => {
                write!(f, "waitfor {port} counts the arrival of {member} in {round}, which it gave up")
            }
            Self::OwesConfirm(port) => write!(f, "waitfor {port} owes a CONFIRM that nothing asks for"),
            Self::Levels(depth) => write!(f, "handler {depth} runs where it could not have begun"),
            Self::NotOffered(port, source, id) => {
                write!(f, "port {port} holds message {id} of {source}, which should have been offered")
            }
            Self::RejectedTooOften(port, source, id) => {
                write!(
                    f,
                    "message {id} of {source} on port {port} was rejected more often than ranks stand above it"
                )
            }
            Self::RejectedTooLong(port, source, id) => {
                write!(
                    f,
                    "message {id} of {source} on port {port} is not offered again when its penalty is over"
                )
            }
            Self::Timers(id) => write!(f, "two timers or delays of the task are called {}", id.0),
            Self::TimerNotOffered(id) => write!(f, "timer {} is over, and its handler should run", id.0),
            Self::PastLease(until) => {
                write!(f, "the lease, or the wait for it, should have ended at {until}")
            }
            Self::OutOfOrder(port) => write!(f, "what waits at port {port} is not in order"),
            Self::WrongDeadline => f.write_str("the next deadline that is kept is not the next one"),
            Self::WrongCall => f.write_str("what the task is to be told of its lease is not so"),
            Self::HoldsFragments(port, source) => {
                write!(f, "port {port} holds fragments of {source} that cannot become a message")
            }
        }
    }
}

impl core::error::Error for Violation {}
