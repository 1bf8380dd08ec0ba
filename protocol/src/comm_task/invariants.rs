//! What holds of every communication task after every input. The checker, the simulator, the validator of recordings
//! and debug runs all call [`check`]; a violation is a fault of the machine, never of a program or of the network.

use super::desk::{Desk, Phase};
use super::inbox::{Aged, Held, Inbox};
use super::lease::{Lease, Post};
use super::levels::{DEPTH, Finished};
use super::memory::{Fate, Remembered};
use super::rendezvous::Rendezvous;
use super::{CommTask, Pending};
use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::packet::Class;
use crate::request::{Call, TimeId};
use crate::rules::{Aging, Memory};
use crate::table::{NodeTable, Port};
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
    /// The task waits for an answer that nobody was asked for, or for one under another life's id; or the other way round.
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
    /// More handlers run than may, one ranks lower than what it interrupted, or what it interrupted neither waits nor
    /// stands between two statements (D15).
    Levels(u8),
    /// A message for a handler is due, and was not offered to a thread that can be interrupted (D15).
    NotOffered(PortId, TaskId, MessageId),
    /// A message was rejected more often than ranks stand above it, or at all where rejections do not count (D58).
    RejectedTooOften(PortId, TaskId, MessageId),
    /// A message that was rejected waits longer than the port's penalty until it is offered again (D58).
    RejectedTooLong(PortId, TaskId, MessageId),
    /// Two of the task's timers and delays have one name.
    Timers(TimeId),
    /// A timer is over and outranks a thread that can be interrupted, and its handler has not begun (D15).
    TimerNotOffered(TimeId),
    /// A message that is not whole has no time left, or is held where messages take one packet (D28).
    HoldsFragments(PortId, TaskId),
    /// The task acts past its lease, or has not taken over when it should have (D61).
    PastLease(Ticks),
    /// What the task is to be told of its lease is not so.
    WrongCall,
    /// An order that is kept over what waits is not what a look at all of it says.
    OutOfOrder(PortId),
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
            Self::WrongCall => f.write_str("what the task is to be told of its lease is not so"),
            Self::HoldsFragments(port, source) => {
                write!(f, "port {port} holds fragments of {source} that cannot become a message")
            }
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
    check_levels(task)?;
    check_timers(task, table)?;
    task.lease.iter().try_for_each(|lease| check_lease(task, lease))?;
    for (i, desk) in task.desks.iter().enumerate() {
        check_desk(task, super::index(i), desk)?;
    }
    for (i, meeting) in task.meetings.iter().enumerate() {
        let waits = task.running().iter().any(|level| level.pending == Pending::Meeting(super::index(i)));
        if waits != meeting.deadline.is_some() {
            return Err(Violation::MeetingAndWaitDiffer(meeting.port));
        }
        check_meeting(task, table, meeting)?;
    }
    task.out_of_order().map_or(Ok(()), |port| Err(Violation::OutOfOrder(port)))
}

/// Nobody acts past its lease, and whoever acts does so in an epoch (D61).
fn check_lease(task: &CommTask, lease: &Lease) -> Result<(), Violation> {
    let until = match lease.post {
        Post::Leased(until) => until,
        Post::Waits => lease.takeover_at,
        Post::Alone | Post::Passive => Ticks::FAR,
    };
    if until <= task.now {
        return Err(Violation::PastLease(until));
    }
    let told = match lease.call {
        Some(Call::TakeOver(epoch)) => lease.acts() && epoch == lease.epoch,
        Some(Call::Fenced) => !lease.acts(),
        Some(Call::Message(_) | Call::Timer(_)) => false,
        None => true,
    };
    if told { Ok(()) } else { Err(Violation::WrongCall) }
}

fn check_inbox(task: &CommTask, table: &NodeTable, inbox: &Inbox) -> Result<(), Violation> {
    let port = table.port(inbox.port).ok_or(Violation::Overfull(inbox.port))?;
    if inbox.queue.len() > usize::from(port.decl.bounded_buffer) {
        return Err(Violation::Overfull(inbox.port));
    }
    // The variants lengthen lives where a message waits: it outlives what its sender, and the memory, think of it.
    let exact = table.rules().charge_residence && !port.decl.lengthens_lives();
    for (slot, held) in inbox.queue.iter() {
        let aged = inbox.queue.side(slot);
        let (id, source) = (inbox.port, held.source);
        if held.expires <= task.now {
            return Err(Violation::HoldsExpired(id, source, held.id()));
        }
        if held.class != port.decl.class || !port.admits(source, task.task) {
            return Err(Violation::HoldsForeign(id, source, held.id()));
        }
        let remembers = table.rules().memory == Memory::LifeAndLink && exact;
        if remembers && held.class == Class::Command && !is_remembered(task, inbox, held) {
            return Err(Violation::NotRemembered(id, source, held.id()));
        }
        check_rejections(task, table, port, held, aged)?;
        if inbox.handled && task.interruptible(false) && aged.not_before <= task.now {
            return Err(Violation::NotOffered(id, source, held.id()));
        }
    }
    for (at, source) in inbox.sources.iter().enumerate() {
        let open = inbox.assembly(at).filter(|assembly| assembly.is_open());
        if open.is_some_and(|assembly| assembly.expires <= task.now || port.decl.fragments < 2) {
            return Err(Violation::HoldsFragments(inbox.port, source.task));
        }
        if exact {
            source.command().into_iter().try_for_each(|command| check_memory(source.task, command))?;
        }
    }
    Ok(())
}

/// How often and for how long a message was rejected (D58).
fn check_rejections(
    task: &CommTask,
    table: &NodeTable,
    port: &Port,
    held: &Held,
    aged: Aged,
) -> Result<(), Violation> {
    let penalty = port.decl.penalty;
    let counts = table.rules().aging == Aging::Bounded && !port.decl.lengthens_lives();
    let cap = if counts { CommTask::cap(task.order.rank(port.id, held.source)) } else { 0 };
    let (id, source) = (port.id, held.source);
    if aged.rejections > cap {
        return Err(Violation::RejectedTooOften(id, source, held.id()));
    }
    let length = penalty.map_or(table.cell().tick, |penalty| penalty.length).max(Ticks(1));
    if aged.not_before > task.now + length {
        return Err(Violation::RejectedTooLong(id, source, held.id()));
    }
    Ok(())
}

fn check_timers(task: &CommTask, table: &NodeTable) -> Result<(), Violation> {
    let delays = task.running().iter().filter_map(|level| match level.pending {
        Pending::Delay(id, _) => Some(id),
        Pending::Nothing
        | Pending::Get { .. }
        | Pending::Reply(_)
        | Pending::Meeting(_)
        | Pending::Work
        | Pending::Lease
        | Pending::Boundary => None,
    });
    let mut names = [0_u64; 4];
    for id in delays.chain(task.timers.0.iter().flatten().map(|started| started.id)) {
        let (word, bit) = (usize::from(id.0 / 64), 1 << (id.0 % 64));
        if names[word] & bit != 0 {
            return Err(Violation::Timers(id));
        }
        names[word] |= bit;
    }
    task.kept_timer(table).map_or(Ok(()), |id| Err(Violation::TimerNotOffered(id)))
}

fn is_remembered(task: &CommTask, inbox: &Inbox, held: &Held) -> bool {
    let command = inbox.source(held.source).and_then(|at| inbox.sources[at].command());
    command.is_some_and(|c| c.id == held.id() && c.fate == Fate::Held && c.until > task.now)
}

fn check_memory(source: TaskId, command: &Remembered) -> Result<(), Violation> {
    let budget_fits = match command.fate {
        Fate::Delivered(budget_ends) => budget_ends <= command.sender_until,
        Fate::Held | Fate::Lapsed | Fate::Refused | Fate::Answered(_) => true,
    };
    if command.until < command.sender_until || !budget_fits {
        return Err(Violation::MemoryTooShort(source, command.id));
    }
    Ok(())
}

fn check_levels(task: &CommTask) -> Result<(), Violation> {
    if usize::from(task.depth) > DEPTH {
        return Err(Violation::Levels(task.depth));
    }
    if let Pending::Get { deadline, .. } = task.top().pending
        && deadline < task.now
    {
        return Err(Violation::Overdue(deadline));
    }
    let running = task.running();
    for (i, level) in (0_u8..).zip(running) {
        let top = i == task.depth;
        let suspended = level.finished.is_some() != (level.pending != Pending::Nothing);
        let ranks = i < 2 || level.rank <= running[usize::from(i) - 1].rank;
        let between = top && level.pending == Pending::Boundary;
        if (!top && (!suspended || level.atomic)) || (top && level.finished.is_some()) || !ranks || between {
            return Err(Violation::Levels(i));
        }
    }
    Ok(())
}

fn check_desk(task: &CommTask, at: u16, desk: &Desk) -> Result<(), Violation> {
    let waits = task.running().iter().any(|level| level.pending == Pending::Reply(at));
    let ended = task
        .running()
        .iter()
        .any(|level| matches!(level.finished, Some(Finished::Answers(d) | Finished::Long(d)) if d == at));
    if waits != (desk.phase == Phase::Open) || ended != (desk.phase == Phase::Ended) {
        return Err(Violation::WaitsForNothing(desk.port));
    }
    if desk.phase != Phase::Open {
        return Ok(());
    }
    if desk.deadline < task.now {
        return Err(Violation::Overdue(desk.deadline));
    }
    let own =
        |id: MessageId| id.incarnation == task.incarnation && task.next_sequence.is_newer_than(id.sequence);
    if desk.open().next().is_none() || !desk.open().all(|asked| own(asked.id)) {
        return Err(Violation::WaitsForNothing(desk.port));
    }
    let due = desk.copy_at < task.now;
    let idle = desk.copies_left == 0 && desk.copy_at != Ticks::FAR;
    if due || idle { Err(Violation::ResendInstant(desk.port)) } else { Ok(()) }
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

#[cfg(test)]
mod tests;
