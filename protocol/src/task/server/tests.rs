use super::inbox::Long;
use super::ready::ReadySet;
use super::*;
use crate::cell::{PortDecl, Usage};
use crate::ids::MessageId;
use crate::task::fixture::{A, B, Fixture, MOVE};
use crate::task::violation::Violation;
use crate::task::wait::Pending;
use alloc::format;

/// A command that A sends.
fn command(bench: &Fixture, remaining: Ticks) -> Packet {
    let port = bench.table.port(MOVE).unwrap();
    let contents = Contents::new(b"go").unwrap();
    mapping::message(port, A, B, MessageId::default(), remaining, contents)
}

/// Lets B receive a packet at instant 10, while B's thread does not wait.
fn hear(bench: &mut Fixture, server: &mut Server, threads: &Interrupts, packet: &Packet) -> Option<Arrival> {
    let table = bench.table.clone();
    let ends = Fixture::ends(&table, packet);
    server.hear(&mut bench.at(Instant(10)), (threads, false), (ends, 0), packet)
}

/// A fixture in which a command of A waits at B.
fn holding() -> (Fixture, Server) {
    let mut bench = Fixture::new(B);
    let mut server = Server::new(&bench.table, &bench.own);
    let packet = command(&bench, Ticks(20));
    assert!(hear(&mut bench, &mut server, &Interrupts::default(), &packet).is_none());
    assert_eq!(server.check(&bench.table, &bench.own, true), Ok(()));
    (bench, server)
}

#[test]
fn a_command_is_taken_once_and_a_copy_gets_the_same_answer() {
    let (mut bench, mut server) = holding();
    let (origin, held) = server.next(&bench.at(Instant(12)), None, None).expect("a message");
    let delivery = server.deliver(&mut bench.at(Instant(12)), origin, &held);
    assert_eq!((delivery.budget, delivery.contents.as_bytes()), (Ticks(18), &b"go"[..]));
    assert!(server.next(&bench.at(Instant(12)), None, None).is_none());
    let copy = command(&bench, Ticks(19));
    assert!(hear(&mut bench, &mut server, &Interrupts::default(), &copy).is_none());
    assert!(bench.packets().is_empty(), "it is not answered yet");
    let done = Contents::new(b"done").unwrap();
    let left = server.reply(&mut bench.at(Instant(13)), (0, 0), delivery.from, done);
    assert_eq!(left, Ok(Ticks(17)));
    let again = server.reply(&mut bench.at(Instant(13)), (0, 0), delivery.from, done);
    assert_eq!(again, Err(crate::request::Fault::NothingToAnswer));
    assert!(hear(&mut bench, &mut server, &Interrupts::default(), &copy).is_none());
    assert_eq!(bench.packets()[0].contents, done);
}

#[test]
fn who_waits_gets_a_message_as_it_arrives() {
    let (mut bench, mut threads) = (Fixture::new(B), Interrupts::default());
    let mut server = Server::new(&bench.table, &bench.own);
    threads.wait(Pending::Get { port: None, source: None, deadline: Instant::NEVER });
    let packet = command(&bench, Ticks(20));
    let arrival = hear(&mut bench, &mut server, &threads, &packet).expect("a message");
    assert!(!arrival.interrupts);
    assert_eq!((arrival.origin, arrival.held.expires), ((0, 0), Instant(30)));
}

#[test]
fn what_has_no_time_left_is_dropped() {
    let (mut bench, mut server) = holding();
    assert_eq!(server.next_end(), Instant(30));
    server.advance(&mut bench.at(Instant(30)));
    assert_eq!(bench.effects.observed.last().unwrap().event, Event::Discarded(Reason::Expired));
    assert!(server.next(&bench.at(Instant(30)), None, None).is_none());
    let late = command(&bench, Ticks::ZERO);
    assert!(hear(&mut bench, &mut server, &Interrupts::default(), &late).is_none());
    assert_eq!(bench.effects.observed.last().unwrap().event, Event::Discarded(Reason::ExpiredOnTheWay));
}

/// The violation that `check` finds after a fault was planted.
fn planted(fault: impl FnOnce(&mut Server)) -> Violation {
    let (bench, mut server) = holding();
    fault(&mut server);
    server.check(&bench.table, &bench.own, true).unwrap_err()
}

#[test]
fn a_planted_fault_in_a_buffer_or_memory_is_found() {
    let id = MessageId::default();
    let inbox = |server: &mut Server, change: fn(&mut Held)| {
        server.inboxes[0].queue.change_all(|held, _| change(held));
    };
    assert_eq!(planted(|s| inbox(s, |h| h.expires = Instant(10))), Violation::HoldsExpired(MOVE, A, id));
    assert_eq!(planted(|s| inbox(s, |h| h.class = Class::Status)), Violation::HoldsForeign(MOVE, A, id));
    let forgotten = planted(|s| s.inboxes[0].sources[0].remember(None));
    assert_eq!(forgotten, Violation::NotRemembered(MOVE, A, id));
    let memory = |server: &mut Server, change: fn(&mut DedupEntry)| {
        change(server.inboxes[0].sources[0].command_mut().unwrap());
    };
    let not_remembered = Violation::NotRemembered(MOVE, A, id);
    assert_eq!(planted(|s| memory(s, |c| c.status = CommandStatus::Refused)), not_remembered);
    assert_eq!(planted(|s| memory(s, |c| c.until = Instant(10))), not_remembered);
    assert_eq!(planted(|s| memory(s, |c| c.until = Instant(15))), Violation::MemoryTooShort(A, id));
}

#[test]
fn an_order_that_was_not_kept_right_is_found() {
    let held = |s: &mut Server, change: fn(&mut Held)| s.inboxes[0].queue.change_all(|held, _| change(held));
    assert_eq!(planted(|s| held(s, |h| h.expires += Ticks(1))), Violation::OutOfOrder(MOVE));
    assert_eq!(planted(|s| s.inboxes[0].since = 7), Violation::OutOfOrder(MOVE));
    assert_eq!(planted(|s| s.ready = ReadySet::new(&s.inboxes)), Violation::OutOfOrder(MOVE));
}

#[test]
fn a_planted_fault_on_a_port_with_a_handler_is_found() {
    let holds = |s: &mut Server, change: fn(&mut RetryState)| {
        s.inboxes[0].handled = true;
        s.inboxes[0].queue.watch();
        s.inboxes[0].queue.change_all(|_, retry| change(retry));
    };
    let id = MessageId::default();
    let offered = planted(|s| holds(s, |h| h.not_before = Instant(10)));
    assert_eq!(offered, Violation::NotOffered(MOVE, A, id));
    let often = planted(|s| holds(s, |h| (h.rejections, h.not_before) = (9, Instant(11))));
    assert_eq!(often, Violation::RejectedTooOften(MOVE, A, id));
    let twice = planted(|s| holds(s, |h| (h.rejections, h.not_before) = (2, Instant(11))));
    assert_eq!(twice, often, "no rank stands above it");
    let long = planted(|s| holds(s, |h| (h.rejections, h.not_before) = (1, Instant(12))));
    assert_eq!(long, Violation::RejectedTooLong(MOVE, A, id));
    let parts = planted(|s| {
        let mut long = PortDecl::new("move", A, Usage::Send, &[B], Ticks(20));
        long.fragments = 2;
        s.inboxes[0].long = Long::new(&long, 1);
        s.inboxes[0].assembly_mut(0).unwrap().have = 1;
    });
    assert_eq!(parts, Violation::HoldsFragments(MOVE, A));
    for violation in [offered, often, long, parts] {
        assert!(format!("{violation}").len() > 20, "{violation}");
    }
}
