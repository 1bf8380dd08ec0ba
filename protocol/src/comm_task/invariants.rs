//! What holds of every communication task after every input. The checker, the simulator, the validator of recordings
//! and debug runs all call [`check`]; a violation is a fault of the machine, never of a program or of the network.

use super::inbox::{Held, Inbox};
use super::memory::{Fate, Remembered};
use super::rendezvous::Rendezvous;
use super::{CommTask, Command, Pending, Role};
use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::packet::Class;
use crate::rules::Memory;
use crate::table::NodeTable;
use crate::ticks::Ticks;
use core::fmt;

/// An invariant that does not hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Violation {
    /// A port's buffer holds more than its `bounded_buffer` (§5.1.1).
    Overfull(PortId),
    /// A buffer holds a message that has no time left (§5.1.1).
    HoldsExpired(PortId, TaskId, MessageId),
    /// A buffer holds a message of a class or from a task that the port does not admit.
    HoldsForeign(PortId, TaskId, MessageId),
    /// A buffer holds a command that the memory of its source does not know as held: a copy would run twice (D52).
    NotRemembered(PortId, TaskId, MessageId),
    /// The memory of a command ends before its sender's wait, or its execution budget ends after it (D6, D18).
    MemoryTooShort(TaskId, MessageId),
    /// The task waits past its deadline.
    Overdue(Ticks),
    /// The task waits for an answer on a port that it does not send on, or for one under another life's id.
    WaitsForNothing(PortId),
    /// The task waits at a `waitfor` that does not know of it, or the other way round.
    MeetingAndWaitDiffer(PortId),
    /// A re-sending instant does not follow from the deadline, or stands where nothing is to be sent (D5, D55).
    ResendInstant(PortId),
    /// A `waitfor` released a round that it never announced, or forgot the freshest one it heard of (D54).
    Rounds(PortId),
    /// A `waitfor` holds the arrival of a member in a round that the member has given up (D54).
    HoldsBarred(PortId, TaskId, Round),
    /// A `waitfor` owes a CONFIRM of nothing, or while it waits for the next meeting (D1).
    OwesConfirm(PortId),
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
            Self::WaitsForNothing(port) => write!(f, "the task waits for an answer that port {port} cannot give"),
            Self::MeetingAndWaitDiffer(port) => {
                write!(f, "the task and waitfor {port} do not agree whether it waits")
            }
            Self::ResendInstant(port) => write!(f, "port {port} sends again at an instant that nothing asks for"),
            Self::Rounds(port) => write!(f, "the rounds of waitfor {port} contradict each other"),
            Self::HoldsBarred(port, member, round) => {
                write!(f, "waitfor {port} counts the arrival of {member} in {round}, which it gave up")
            }
            Self::OwesConfirm(port) => write!(f, "waitfor {port} owes a CONFIRM that nothing asks for"),
        }
    }
}

impl core::error::Error for Violation {}

/// Checks one communication task between two inputs. Costs one look at everything it holds; allocates nothing.
///
/// # Errors
/// The first violation found.
pub fn check(task: &CommTask, table: &NodeTable) -> Result<(), Violation> {
    task.inboxes.iter().try_for_each(|inbox| check_inbox(task, table, inbox))?;
    // Under the reading without residence a message outlives what its sender, and the memory, think of it.
    for source in task.sources.iter().filter(|_| table.rules().charge_residence) {
        source.command.iter().try_for_each(|command| check_memory(source.task, command))?;
    }
    check_pending(task)?;
    for (i, meeting) in task.meetings.iter().enumerate() {
        let waits = task.pending == Pending::Meeting(super::index(i));
        if waits != meeting.deadline.is_some() {
            return Err(Violation::MeetingAndWaitDiffer(meeting.port));
        }
        check_meeting(task, table, meeting)?;
    }
    Ok(())
}

fn check_inbox(task: &CommTask, table: &NodeTable, inbox: &Inbox) -> Result<(), Violation> {
    let port = table.port(inbox.port).ok_or(Violation::Overfull(inbox.port))?;
    if inbox.queue.len() > usize::from(port.decl.bounded_buffer) {
        return Err(Violation::Overfull(inbox.port));
    }
    for (_, _, held) in inbox.queue.iter() {
        if held.expires <= task.now {
            return Err(Violation::HoldsExpired(inbox.port, held.source, held.id));
        }
        if held.class != port.decl.class || !port.admits(held.source, task.task) {
            return Err(Violation::HoldsForeign(inbox.port, held.source, held.id));
        }
        let remembers = table.rules().memory == Memory::LifeAndLink && table.rules().charge_residence;
        if remembers && held.class == Class::Command && !is_remembered(task, inbox.port, held) {
            return Err(Violation::NotRemembered(inbox.port, held.source, held.id));
        }
    }
    Ok(())
}

fn is_remembered(task: &CommTask, port: PortId, held: &Held) -> bool {
    let at = task.sources.binary_search_by_key(&held.source, |source| source.task);
    let command = at.ok().and_then(|at| task.sources[at].command);
    command.is_some_and(|c| c.port == port && c.id == held.id && c.fate == Fate::Held && c.until > task.now)
}

fn check_memory(source: TaskId, command: &Remembered) -> Result<(), Violation> {
    let budget_fits = match command.fate {
        Fate::Delivered(budget_ends) => budget_ends <= command.sender_until,
        Fate::Held | Fate::Refused | Fate::Answered(_) => true,
    };
    if command.until < command.sender_until || !budget_fits {
        return Err(Violation::MemoryTooShort(source, command.id));
    }
    Ok(())
}

fn check_pending(task: &CommTask) -> Result<(), Violation> {
    match &task.pending {
        Pending::Get { deadline, .. } if *deadline < task.now => Err(Violation::Overdue(*deadline)),
        Pending::Reply(command) => check_command(task, command),
        Pending::Nothing | Pending::Get { .. } | Pending::Meeting(_) | Pending::Delay(_) => Ok(()),
    }
}

fn check_command(task: &CommTask, command: &Command) -> Result<(), Violation> {
    if command.deadline < task.now {
        return Err(Violation::Overdue(command.deadline));
    }
    let own = command.id.incarnation == task.incarnation && task.next_sequence.is_newer_than(command.id.sequence);
    if task.role(command.port) != Some(Role::Sends) || !own {
        return Err(Violation::WaitsForNothing(command.port));
    }
    let due = command.copy_at < task.now;
    let idle = command.copies_left == 0 && command.copy_at != Ticks::FAR;
    if due || idle { Err(Violation::ResendInstant(command.port)) } else { Ok(()) }
}

fn check_meeting(task: &CommTask, table: &NodeTable, meeting: &Rendezvous) -> Result<(), Violation> {
    let now = task.now;
    let period = table.port(meeting.port).map_or(Ticks::FAR, |port| port.decl.resend);
    let resend_at = match meeting.deadline {
        Some(deadline) if deadline < now => return Err(Violation::Overdue(deadline)),
        Some(deadline) => Rendezvous::resend_instant(deadline, now, period),
        None => Ticks::FAR,
    };
    let copies = meeting.copy_at >= now && (meeting.copies_left > 0 || meeting.copy_at == Ticks::FAR);
    if meeting.resend_at != resend_at || !copies {
        return Err(Violation::ResendInstant(meeting.port));
    }
    let never_announced = meeting.released.is_some_and(|released| released.is_newer_than(meeting.announced));
    if never_announced || meeting.announced.is_newer_than(meeting.fresh) {
        return Err(Violation::Rounds(meeting.port));
    }
    if meeting.owes_confirm && (meeting.deadline.is_some() || meeting.released.is_none()) {
        return Err(Violation::OwesConfirm(meeting.port));
    }
    let parties = table.port(meeting.port).map_or(&[][..], |port| &port.parties);
    for (member, party) in meeting.members.iter().zip(parties) {
        if let (Some(arrived), Some(barred)) = (member.arrived, member.barred)
            && !arrived.round.is_newer_than(barred)
        {
            return Err(Violation::HoldsBarred(meeting.port, party.task, arrived.round));
        }
    }
    Ok(())
}
