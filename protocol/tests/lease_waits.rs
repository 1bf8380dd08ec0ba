//! Work-coupled tasks whose partners restart, and tasks that wait for the lease (R8; D30, D49, D61).

use crate::support::{self, NextExpiry, Solo, order};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const P: TaskId = TaskId(0);
const S: TaskId = TaskId(1);
const NP: NodeId = NodeId(0);
const NS: NodeId = NodeId(1);
const ALIVE: PortId = PortId(0);

const LEASE: u64 = 14;
const TAKEOVER: u64 = 32;
const EVERY: u64 = 4;

/// A cell with two robots on two nodes. Their link delays a packet by at most one tick.
fn cell(mutual: bool) -> Cell {
    let mut cell = Cell::new("couple", Ticks(1));
    let (a, b) = (cell.node("p"), cell.node("s"));
    cell.link(a, b, Ticks(1));
    let (primary, standby) = (cell.task("p", a), cell.task("s", b));
    let via = cell.port(PortDecl::new("alive", primary, Usage::Response, &[standby], Ticks(6)));
    cell.couples.push(CoupleDecl {
        primary,
        standby,
        lease: Ticks(LEASE),
        takeover: Ticks(TAKEOVER),
        every: Ticks(EVERY),
        via,
        trusted: false,
        mutual,
    });
    cell
}

fn table(mutual: bool) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell(mutual)).expect("a checked cell"))
}

/// The primary and the standby of a couple, without other tasks. Heartbeats and answers take no time.
struct Couple {
    p: Solo,
    s: Solo,
}

impl Couple {
    fn new(mutual: bool) -> Self {
        let table = table(mutual);
        Self { p: Solo::new(&table, P), s: Solo::new(&table, S) }
    }

    /// Lets the standby send its next heartbeat, and the primary answer it. Returns the heartbeat and the primary's
    /// signals.
    fn heartbeat(&mut self) -> (Packet, Vec<String>) {
        let due = self.s.task.next_expiry().expect("a beat is to be sent");
        self.p.pass(due.0);
        let heartbeat = self.s.pass(due.0).packets[0];
        let out = self.p.hear(heartbeat);
        self.s.hear(out.packets[0]);
        (heartbeat, out.signals.iter().map(support::signal).collect())
    }

    /// A couple whose lease is granted. The grant comes with the second heartbeat, which echoes the answer to the first
    /// one; the lease counts from that answer.
    fn granted(mutual: bool) -> (Self, Packet) {
        let mut couple = Self::new(mutual);
        couple.p.ask(Request::Lease);
        assert_eq!(couple.heartbeat().1, Vec::<String>::new());
        let (second, told) = couple.heartbeat();
        assert_eq!(told, ["granted 3"]);
        (couple, second)
    }
}

#[test]
fn an_echo_of_what_an_earlier_incarnation_was_answered_renews_nothing() {
    let (mut couple, second) = Couple::granted(false);
    let left = LEASE - EVERY;
    couple.p.pass(2);
    // The new incarnation of the standby never received the answer that it echoes. Its sequence numbers may continue those
    // of the earlier incarnation.
    let id = MessageId { incarnation: Incarnation(1), sequence: second.id.sequence.next() };
    let echo = Contents::new(&[1, 0, 1, 0]).expect("short");
    let out = couple.p.hear(Packet { id, contents: echo, ..second });
    assert_eq!(out.packets.len(), 1, "the new life is answered");
    couple.p.pass(left - 3);
    assert!(couple.p.task.is_active());
    couple.p.pass(1);
    assert!(!couple.p.task.is_active(), "the lease ran from the first beat");
}

#[test]
fn a_heartbeat_of_an_earlier_incarnation_is_not_answered_once_the_new_one_is_heard_of() {
    let (mut couple, second) = Couple::granted(false);
    let id = MessageId { incarnation: Incarnation(1), sequence: Seq24::default() };
    let first_of_new = Packet { id, contents: Contents::new(&[0; 4]).expect("short"), ..second };
    assert_eq!(couple.p.hear(first_of_new).packets.len(), 1);
    let sequence = second.id.sequence.next();
    let late = Packet { id: MessageId { sequence, ..second.id }, ..second };
    assert!(couple.p.hear(late).packets.is_empty());
}

#[test]
fn a_standby_that_restarts_goes_on_renewing_the_lease() {
    let mut net = VirtualCell::new(cell(false));
    net.ask(P, Request::Lease);
    // The cell runs long enough that the sequence numbers of the new incarnation stay far from those of the earlier
    // incarnation.
    net.run(400);
    assert_eq!(net.heard(P), ["granted 3"]);
    net.restart(NS, 1);
    for _ in 0..200 {
        net.run(1);
        assert!(net.task(P).is_active(), "fenced at {}", net.now());
    }
}

#[test]
fn who_acts_is_granted_the_lease_at_once_and_who_was_fenced_never() {
    let (mut couple, _) = Couple::granted(false);
    assert_eq!(couple.p.ask(Request::Lease).words(), ["granted 3"]);
    couple.p.pass(LEASE);
    assert!(!couple.p.task.is_active());
    assert_eq!(couple.p.ask(Request::Lease).words(), ["fault Fenced"]);
}

/// Lets a task wait for the lease, and a timer's handler interrupt that wait.
fn interrupted(task: &mut Solo) {
    task.ask(order(&[Ranked::Timers, Ranked::Own]));
    task.ask(Request::Start { id: TimeId(1), length: Ticks(2) });
    assert_eq!(task.ask(Request::Lease).words(), Vec::<String>::new());
    let over = Input::TimeOut { id: TimeId(1), turn: 0 };
    assert_eq!(task.input(over).words(), ["interrupt Timer(TimeId(1))"]);
}

#[test]
fn a_wait_for_the_lease_may_be_interrupted_and_ends_when_the_handler_returns() {
    let mut s = Solo::incarnation(&table(false), S, 1, true);
    interrupted(&mut s);
    assert_eq!(s.ask(Request::Lease).words(), ["fault Busy"], "one wait at a time");
    s.pass(TAKEOVER);
    assert!(s.task.is_active());
    assert_eq!(s.ask(Request::Return).words(), ["granted 4"]);
    // The task has already learned of its lease by the grant, so no take-over interrupts the task in addition.
    assert_eq!(s.ask(Request::Boundary).words(), ["accepted 0"]);
}

#[test]
fn a_lease_that_was_granted_and_lost_within_a_handler_is_waited_for_again() {
    let mut couple = Couple::new(true);
    interrupted(&mut couple.p);
    couple.heartbeat();
    assert_eq!(couple.heartbeat().1, Vec::<String>::new(), "the handler goes on");
    assert!(couple.p.task.is_active());
    couple.p.pass(LEASE);
    assert!(!couple.p.task.is_active());
    let told = couple.p.ask(Request::Return).words();
    assert!(!told.iter().any(|word| word.starts_with("granted")), "{told:?}");
    assert!(!couple.p.task.is_active());
}

#[test]
fn heartbeats_and_answers_cut_short_mean_nothing() {
    let (mut couple, second) = Couple::granted(false);
    let id = MessageId { sequence: second.id.sequence.next(), ..second.id };
    let out = couple.p.hear(Packet { id, contents: Contents::new(&[1, 0]).expect("short"), ..second });
    assert!(out.packets.is_empty() && out.signals.is_empty(), "{out:?}");
    let due = couple.s.task.next_expiry().expect("a beat is to be sent");
    let heartbeat = couple.s.pass(due.0).packets[0];
    let answer = couple.p.hear(heartbeat).packets[0];
    let before = couple.s.task.next_expiry();
    couple.s.hear(Packet { contents: Contents::EMPTY, ..answer });
    assert_eq!(couple.s.task.next_expiry(), before);
}

#[test]
fn what_is_no_heartbeat_and_no_answer_is_none_of_the_couples() {
    let (mut couple, second) = Couple::granted(false);
    let kinds = [Kind::Send, Kind::Reply, Kind::Arrive, Kind::Confirm, Kind::Abort, Kind::Control];
    for kind in kinds {
        let out = couple.p.hear(Packet { kind, port: ALIVE, ..second });
        assert!(out.is_nothing(), "{kind:?}: {out:?}");
    }
    assert!(couple.p.task.is_active());
}

#[test]
fn news_of_a_restart_alone_ends_no_lease() {
    let (mut couple, _) = Couple::granted(false);
    couple.p.input(Input::PeerRestarted(NS));
    assert!(couple.p.task.is_active());
    couple.s.input(Input::PeerRestarted(NP));
    assert!(!couple.s.task.is_active());
}

#[test]
fn a_lease_covers_the_heartbeats_that_are_on_their_way() {
    // An answer comes back after 10 ticks, in which two more heartbeats were sent, one every 4 ticks. The delay of the last
    // link is 5 ticks.
    let with = |lease| {
        let mut cell = cell(false);
        cell.links[0].delay = Ticks(5);
        cell.ports[ALIVE.index()].time_out = Ticks(30);
        cell.couples[0].lease = Ticks(lease);
        cell.couples[0].takeover = Ticks(200);
        CellTable::new(cell).map(|_| ())
    };
    let least = Ticks(4 * EVERY + 5 + 1);
    let short = CellError::LeaseTooShort { couple: "p -> s".into(), lease: Ticks(least.0 - 1), least };
    assert_eq!((with(least.0 - 1), with(least.0)), (Err(vec![short]), Ok(())));
}

#[test]
fn heartbeats_need_a_port_between_the_two_alone() {
    let with = |owner: TaskId, users: &[TaskId]| {
        let mut cell = cell(false);
        cell.task("third", NP);
        let via = cell.port(PortDecl::new("via", owner, Usage::Response, users, Ticks(6)));
        cell.couples[0].via = via;
        CellTable::new(cell).map(|_| ())
    };
    let third = TaskId(2);
    assert_eq!(with(P, &[S]), Ok(()));
    let wrong = Err(vec![CellError::NotForHeartbeats("via".into())]);
    for (owner, users) in [(S, &[P][..]), (P, &[S, third]), (P, &[third]), (third, &[S]), (third, &[P, S])] {
        assert_eq!(with(owner, users), wrong, "{owner} asked by {users:?}");
    }
}

#[test]
fn an_actuator_that_is_packed_knows_the_newest_epoch_still() {
    let mut cell = cell(false);
    let arm = cell.task("arm", NS);
    let port = cell.port(PortDecl::new("move", arm, Usage::Receive, &[P, S], Ticks(8)).guard(0));
    let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
    let order = |source: TaskId, epoch: u8| Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: arm,
        source,
        port,
        id: MessageId { incarnation: Incarnation(0), sequence: Frame::SEQUENCE },
        remaining: Ticks(8),
        contents: Contents::new(&[7, epoch]).expect("short"),
        seal: Seal::NONE,
    };
    for (packed, wait) in [(false, 0), (true, 0), (false, 30), (true, 30)] {
        let mut task = Solo::new(&table, arm);
        task.hear(order(S, 3));
        task.ask(support::get(0));
        task.pass(wait);
        if packed {
            let sequences = [Frame::SEQUENCE.next(); 3];
            let frame = Frame { rounds: &[Frame::ROUND; 2], sequences: &sequences, incarnations: true };
            task.task.bury();
            let bytes = Encode::bytes(&frame, |w| task.task.walk(&task.table, w)).expect("it fits");
            let mut read = Solo::new(&table, arm);
            assert_eq!(Decode::read(&bytes, true, |r| read.task.walk(&task.table, r)), bytes.len());
            task = read;
        }
        // The arm forgets an epoch when no message of an older epoch can arrive any more.
        let stale = if wait == 0 { vec![Reason::StaleEpoch] } else { vec![] };
        assert_eq!(task.hear(order(P, 2)).discards(), stale, "packed: {packed}, after {wait}");
    }
}
