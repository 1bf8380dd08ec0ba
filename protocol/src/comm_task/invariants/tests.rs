//! Faults planted into a sound state.

use super::*;
use crate::cell::{Cell, PortDecl, Usage};
use crate::comm_task::heads::Heads;
use crate::comm_task::inbox::Long;
use crate::comm_task::timers::Started;
use crate::comm_task::{Input, Outbox};
use crate::ids::{Incarnation, NodeId, Seq24};
use crate::packet::{Contents, Packet};
use crate::request::{Request, Signal, Target};
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
        task.inboxes[0].queue.change_all(|held, _| change(held));
    };
    assert_eq!(planted(|t| inbox(t, |h| h.expires = Ticks(10))), Violation::HoldsExpired(MOVE, A, id));
    assert_eq!(planted(|t| inbox(t, |h| h.class = Class::Status)), Violation::HoldsForeign(MOVE, A, id));
    let forgotten = planted(|t| t.inboxes[0].sources[0].remember(None));
    assert_eq!(forgotten, Violation::NotRemembered(MOVE, A, id));
    let memory = |task: &mut CommTask, change: fn(&mut Remembered)| {
        change(task.inboxes[0].sources[0].command_mut().unwrap());
    };
    let not_remembered = Violation::NotRemembered(MOVE, A, id);
    assert_eq!(planted(|t| memory(t, |c| c.fate = Fate::Refused)), not_remembered);
    assert_eq!(planted(|t| memory(t, |c| c.until = Ticks(10))), not_remembered);
    assert_eq!(planted(|t| memory(t, |c| c.until = Ticks(15))), Violation::MemoryTooShort(A, id));
}

#[test]
fn an_order_that_was_not_kept_right_is_found() {
    let held =
        |t: &mut CommTask, change: fn(&mut Held)| t.inboxes[0].queue.change_all(|held, _| change(held));
    assert_eq!(planted(|t| held(t, |h| h.expires += Ticks(1))), Violation::OutOfOrder(MOVE));
    assert_eq!(planted(|t| t.inboxes[0].since = 7), Violation::OutOfOrder(MOVE));
    assert_eq!(planted(|t| t.heads = Heads::new(&t.inboxes, 1)), Violation::OutOfOrder(MOVE));
    let copy = |t: &mut CommTask| (t.meetings[0].copies_left, t.meetings[0].copy_at) = (1, Ticks(12));
    assert_eq!(planted(copy), Violation::OutOfOrder(LIFT));
}

#[test]
fn a_planted_fault_in_a_waitfor_is_found() {
    use crate::comm_task::rendezvous::Arrived;
    let meeting = |change: fn(&mut Rendezvous)| planted(|t| change(&mut t.meetings[0]));
    assert_eq!(meeting(|m| m.deadline = None), Violation::MeetingAndWaitDiffer(LIFT));
    assert_eq!(planted(|t| t.top_mut().pending = Pending::Nothing), Violation::MeetingAndWaitDiffer(LIFT));
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
    let planted = |change: fn(&mut Desk)| {
        let (table, mut sender, _) = pair();
        sender.now = Ticks(3);
        change(&mut sender.desks[0]);
        check(&sender, &table)
    };
    assert_eq!(planted(|_| ()), Ok(()));
    assert_eq!(planted(|d| d.deadline = Ticks(2)), Err(Violation::Overdue(Ticks(2))));
    assert_eq!(planted(|d| d.copy_at = Ticks(2)), Err(Violation::ResendInstant(MOVE)));
    assert_eq!(planted(|d| d.copies_left = 0), Err(Violation::ResendInstant(MOVE)));
    assert_eq!(planted(|d| d.phase = Phase::Closed), Err(Violation::WaitsForNothing(MOVE)));
    assert_eq!(planted(|d| d.phase = Phase::Ended), Err(Violation::WaitsForNothing(MOVE)));
    assert_eq!(planted(|d| d.asked[0].id.sequence = Seq24::new(1)), Err(Violation::WaitsForNothing(MOVE)));
}

#[test]
fn a_planted_fault_among_handlers_is_found() {
    use crate::comm_task::levels::Level;
    let holds = |t: &mut CommTask, change: fn(&mut Aged)| {
        t.inboxes[0].handled = true;
        t.inboxes[0].queue.watch();
        t.inboxes[0].queue.change_all(|_, aged| change(aged));
    };
    let id = MessageId::default();
    assert_eq!(planted(|t| holds(t, |h| h.not_before = Ticks(10))), Violation::NotOffered(MOVE, A, id));
    let often = planted(|t| holds(t, |h| (h.rejections, h.not_before) = (9, Ticks(11))));
    assert_eq!(often, Violation::RejectedTooOften(MOVE, A, id));
    let twice = planted(|t| holds(t, |h| (h.rejections, h.not_before) = (2, Ticks(11))));
    assert_eq!(twice, often, "no rank stands above it");
    let long = planted(|t| holds(t, |h| (h.rejections, h.not_before) = (1, Ticks(12))));
    assert_eq!(long, Violation::RejectedTooLong(MOVE, A, id));
    assert_eq!(planted(|t| t.depth = 11), Violation::Levels(11));
    assert_eq!(planted(|t| t.levels[0].finished = Some(Finished::Answers(0))), Violation::Levels(0));
    let two = planted(|t| {
        t.depth = 2;
        t.levels[1] = Level { rank: 1, pending: Pending::Work, ..Level::NEW };
        t.levels[2] = Level { rank: 2, ..Level::NEW };
    });
    assert_eq!(two, Violation::Levels(2));
    let late =
        planted(|t| t.levels[0].pending = Pending::Get { port: None, source: None, deadline: Ticks(9) });
    assert_eq!(late, Violation::Overdue(Ticks(9)));
    let parts = planted(|t| {
        let mut long = PortDecl::new("move", A, Usage::Send, &[TaskId(1)], Ticks(20));
        long.fragments = 2;
        t.inboxes[0].long = Long::new(&long, 1);
        t.inboxes[0].assembly_mut(0).unwrap().have = 1;
    });
    assert_eq!(parts, Violation::HoldsFragments(MOVE, A));
    let get = Pending::Get { port: None, source: None, deadline: Ticks::FAR };
    let started = |ended| Some(Started { id: TimeId(7), turn: 0, ended });
    let named = planted(|t| t.timers.0 = [started(false); CommTask::TIMERS]);
    let over = planted(|t| (t.timers.0[1], t.levels[0].pending) = (started(true), get));
    assert_eq!([named, over], [Violation::Timers(TimeId(7)), Violation::TimerNotOffered(TimeId(7))]);
    for violation in
        [two, often, long, named, over, parts, planted(|t| holds(t, |h| h.not_before = Ticks(10)))]
    {
        assert!(format!("{violation}").len() > 20, "{violation}");
    }
}

#[test]
fn a_planted_fault_in_a_lease_is_found() {
    use crate::cell::CoupleDecl;
    use crate::comm_task::lease::Post;
    let mut cell = Cell::new("couple", Ticks(1));
    let node = cell.node("n");
    let (p, s) = (cell.task("p", node), cell.task("s", node));
    let via = cell.port(PortDecl::new("alive", p, Usage::Response, &[s], Ticks(6)));
    let (lease, takeover, every) = (Ticks(14), Ticks(32), Ticks(4));
    let (trusted, mutual) = (false, false);
    cell.couples.push(CoupleDecl { primary: p, standby: s, lease, takeover, every, via, trusted, mutual });
    let table = NodeTable::new(Arc::new(CellTable::new(cell).unwrap()), NodeId(0));
    let planted = |of: TaskId, change: fn(&mut Lease)| {
        let mut task = CommTask::new(&table, of, Incarnation(0), false);
        task.handle(&table, Input::Advance(Ticks(5)), &mut Packets::default());
        assert_eq!(check(&task, &table), Ok(()));
        change(task.lease.as_mut().unwrap());
        check(&task, &table)
    };
    assert_eq!(planted(p, |l| l.post = Post::Leased(Ticks(5))), Err(Violation::PastLease(Ticks(5))));
    assert_eq!(planted(p, |l| l.post = Post::Leased(Ticks(6))), Ok(()));
    assert_eq!(planted(s, |l| l.takeover_at = Ticks(4)), Err(Violation::PastLease(Ticks(4))));
    assert_eq!(planted(s, |l| l.call = Some(Call::TakeOver(0))), Err(Violation::WrongCall));
    assert_eq!(
        planted(s, |l| (l.post, l.call) = (Post::Alone, Some(Call::Fenced))),
        Err(Violation::WrongCall)
    );
    assert_eq!(
        planted(s, |l| (l.post, l.call) = (Post::Alone, Some(Call::TakeOver(7)))),
        Err(Violation::WrongCall)
    );
    assert_eq!(planted(s, |l| (l.post, l.call) = (Post::Alone, Some(Call::TakeOver(l.epoch)))), Ok(()));
    assert_eq!(planted(p, |l| l.call = Some(Call::Timer(TimeId(0)))), Err(Violation::WrongCall));
}
