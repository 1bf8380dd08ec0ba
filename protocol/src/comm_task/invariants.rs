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
        Pending::Nothing | Pending::Get { .. } | Pending::Meeting(_) | Pending::Delay(..) => Ok(()),
    }
}

fn check_command(task: &CommTask, command: &Command) -> Result<(), Violation> {
    if command.deadline < task.now {
        return Err(Violation::Overdue(command.deadline));
    }
    let own =
        command.id.incarnation == task.incarnation && task.next_sequence.is_newer_than(command.id.sequence);
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

#[cfg(test)]
mod tests {
    use super::super::{Input, Outbox};
    use super::*;
    use crate::cell::{Cell, PortDecl, Usage};
    use crate::ids::{Incarnation, NodeId, Seq24};
    use crate::packet::{Contents, Packet};
    use crate::request::{Request, Signal, Target, TimeId};
    use crate::table::CellTable;
    use alloc::format;
    use alloc::sync::Arc;
    use alloc::vec::Vec;

    const MOVE: PortId = PortId(0);
    const LIFT: PortId = PortId(1);
    const A: TaskId = TaskId(0);

    #[derive(Default)]
    struct Packets(Vec<Packet>);

    impl Outbox for Packets {
        fn transmit(&mut self, packet: Packet) {
            self.0.push(packet);
        }
        fn signal(&mut self, _: Signal) {}
        fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}
        fn disarm(&mut self, _: TimeId) {}
    }

    /// Task B waits at the waitfor and holds a command of task A; task A waits for the answer.
    fn pair() -> (NodeTable, CommTask, CommTask) {
        let mut cell = Cell::new("pair", Ticks(1));
        let node = cell.node("n");
        let (a, b) = (cell.task("a", node), cell.task("b", node));
        cell.port(PortDecl::new("move", a, Usage::Send, &[b], Ticks(20)).command().retry(2, Ticks(4)));
        cell.port(PortDecl::new("lift", b, Usage::Waitfor, &[a], Ticks(40)).resend(Ticks(6), 1));
        let table = NodeTable::new(Arc::new(CellTable::new(cell).unwrap()), NodeId(0));
        let task = |t| CommTask::new(&table, t, Incarnation(0), false);
        let (mut sender, mut receiver) = (task(a), task(b));
        let mut out = Packets::default();
        receiver.handle(&table, Input::Advance(Ticks(10)), &mut out);
        let contents = Contents::EMPTY;
        let send = Request::Send { port: MOVE, to: Target::One(b), contents, time_out: None };
        sender.handle(&table, Input::Request(send), &mut out);
        receiver.handle(&table, Input::Packet(out.0[0]), &mut out);
        let arrive = Request::Arrive { port: LIFT, arguments: [0; 8], time_out: None };
        receiver.handle(&table, Input::Request(arrive), &mut out);
        assert_eq!((check(&sender, &table), check(&receiver, &table)), (Ok(()), Ok(())));
        (table, sender, receiver)
    }

    /// What `check` says of the receiver after a fault was planted.
    fn planted(fault: impl FnOnce(&mut CommTask)) -> Violation {
        let (table, _, mut receiver) = pair();
        fault(&mut receiver);
        check(&receiver, &table).unwrap_err()
    }

    #[test]
    fn a_planted_fault_in_a_buffer_or_memory_is_found() {
        let id = MessageId::default();
        let inbox = |task: &mut CommTask, change: fn(&mut Held)| {
            task.inboxes[0].queue.rekey(|key, held| {
                change(held);
                key
            });
        };
        assert_eq!(planted(|t| inbox(t, |h| h.expires = Ticks(10))), Violation::HoldsExpired(MOVE, A, id));
        assert_eq!(planted(|t| inbox(t, |h| h.class = Class::Status)), Violation::HoldsForeign(MOVE, A, id));
        assert_eq!(planted(|t| t.sources[0].command = None), Violation::NotRemembered(MOVE, A, id));
        let memory = |task: &mut CommTask, change: fn(&mut Remembered)| {
            change(task.sources[0].command.as_mut().unwrap());
        };
        let not_remembered = Violation::NotRemembered(MOVE, A, id);
        assert_eq!(planted(|t| memory(t, |c| c.fate = Fate::Refused)), not_remembered);
        assert_eq!(planted(|t| memory(t, |c| c.until = Ticks(10))), not_remembered);
        assert_eq!(planted(|t| memory(t, |c| c.until = Ticks(15))), Violation::MemoryTooShort(A, id));
    }

    #[test]
    fn a_planted_fault_in_a_waitfor_is_found() {
        use super::super::rendezvous::Arrived;
        let meeting = |change: fn(&mut Rendezvous)| planted(|t| change(&mut t.meetings[0]));
        assert_eq!(meeting(|m| m.deadline = None), Violation::MeetingAndWaitDiffer(LIFT));
        assert_eq!(planted(|t| t.pending = Pending::Nothing), Violation::MeetingAndWaitDiffer(LIFT));
        assert_eq!(meeting(|m| m.deadline = Some(Ticks(9))), Violation::Overdue(Ticks(9)));
        assert_eq!(meeting(|m| m.resend_at = Ticks(15)), Violation::ResendInstant(LIFT));
        assert_eq!(meeting(|m| m.copy_at = Ticks(15)), Violation::ResendInstant(LIFT));
        assert_eq!(meeting(|m| m.fresh = Round(0)), Violation::Rounds(LIFT));
        assert_eq!(meeting(|m| m.released = Some(Round(2))), Violation::Rounds(LIFT));
        assert_eq!(meeting(|m| m.owes_confirm = true), Violation::OwesConfirm(LIFT));
        let barred = meeting(|m| {
            m.members[1].arrived = Some(Arrived { round: Round(1), expires: Ticks(50), arguments: [0; 8] });
            m.members[1].barred = Some(Round(1));
        });
        assert_eq!(barred, Violation::HoldsBarred(LIFT, A, Round(1)));
        assert_eq!(format!("{barred}"), "waitfor P1 counts the arrival of T0 in r1, which it gave up");
    }

    #[test]
    fn a_planted_fault_in_a_wait_for_an_answer_is_found() {
        let planted = |change: fn(&mut Command)| {
            let (table, mut sender, _) = pair();
            sender.now = Ticks(3);
            let Pending::Reply(command) = &mut sender.pending else { panic!("it waits for the answer") };
            change(command);
            check(&sender, &table)
        };
        assert_eq!(planted(|_| ()), Ok(()));
        assert_eq!(planted(|c| c.deadline = Ticks(2)), Err(Violation::Overdue(Ticks(2))));
        assert_eq!(planted(|c| c.copy_at = Ticks(2)), Err(Violation::ResendInstant(MOVE)));
        assert_eq!(planted(|c| c.copies_left = 0), Err(Violation::ResendInstant(MOVE)));
        assert_eq!(planted(|c| c.port = LIFT), Err(Violation::WaitsForNothing(LIFT)));
        assert_eq!(planted(|c| c.id.sequence = Seq24::new(1)), Err(Violation::WaitsForNothing(MOVE)));
    }
}
