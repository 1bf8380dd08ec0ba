use super::*;
use crate::ids::NodeId;
use crate::observe::Reason;
use crate::packet::Kind;
use crate::request::ReplyTo;
use crate::task::fixture::{A, B, Fixture, MOVE};
use crate::task::interrupts::Interrupts;
use crate::task::violation::Violation;
use crate::task::wait::{Finished, Pending};
use alloc::vec::Vec;

/// A fixture in which task A has asked B, and A's thread waits for the answer.
fn asking() -> (Fixture, Client, Interrupts) {
    let mut bench = Fixture::new(A);
    let (mut client, mut threads) = (Client::new(&bench.table, &bench.own), Interrupts::default());
    let table = bench.table.clone();
    let (port, party) = mapping::own_end(&table, MOVE, A).unwrap();
    let message = (port, Ticks(20), Contents::new(b"go").unwrap());
    let sent = client.send(&mut bench.at(Instant(10)), (party, Target::One(B)), message);
    let Ok(Sent::Request(request)) = sent else { panic!("it asks") };
    threads.wait(Pending::Reply(request));
    assert_eq!(client.check(&bench.own, &threads), Ok(()));
    (bench, client, threads)
}

/// B's answer to the request that A sent.
fn answer(bench: &mut Fixture) -> Packet {
    let request = bench.packets()[0];
    let to = ReplyTo { port: MOVE, source: A, id: request.id };
    mapping::answer(to, B, Kind::Reply, Ticks(5), Contents::new(b"done").unwrap())
}

#[test]
fn an_answer_ends_the_wait_once() {
    let (mut bench, mut client, mut threads) = asking();
    let (answer, table) = (answer(&mut bench), bench.table.clone());
    let ends = Fixture::ends(&table, &answer);
    assert_eq!(client.outstanding().collect::<Vec<_>>(), [(MOVE, B, answer.id)]);
    let ended = client.answer(&mut bench.at(Instant(12)), (ends, 0), &answer).expect("an end");
    assert_eq!(ended.wait, Some(Pending::Reply(0)));
    assert_eq!(ended.finished, Finished::Outcome(Outcome::Reply(answer.contents)));
    threads.end_wait();
    assert_eq!(client.check(&bench.own, &threads), Ok(()));
    assert!(client.answer(&mut bench.at(Instant(13)), (ends, 0), &answer).is_none());
    assert_eq!(bench.effects.observed.last().unwrap().event, Event::Discarded(Reason::Unexpected));
}

#[test]
fn copies_carry_the_same_id_and_what_is_left_until_the_deadline_ends_the_wait() {
    let (mut bench, mut client, _) = asking();
    let first = bench.packets()[0];
    let mut copies = Vec::new();
    let mut end = None;
    for _ in 0..9 {
        let due = client.due(0);
        if due == Instant::NEVER {
            break;
        }
        end = client.advance(&mut bench.at(due), 0).map(|ended| (due, ended.finished)).or(end);
        copies.extend(bench.packets());
    }
    let left: Vec<_> = copies.iter().map(|copy| (copy.id, copy.resent, copy.remaining)).collect();
    assert_eq!(left, [(first.id, true, Ticks(16)), (first.id, true, Ticks(12))]);
    assert_eq!(end, Some((Instant(30), Finished::Outcome(Outcome::TimedOutUnknown))));
}

#[test]
fn a_request_of_which_no_packet_left_the_node_did_not_run() {
    let (mut bench, mut client, _) = asking();
    let id = bench.packets()[0].id;
    client.unsent(id);
    let ended = client.advance(&mut bench.at(Instant(30)), 0).expect("an end");
    assert_eq!(ended.finished, Finished::Outcome(Outcome::TimedOutUnsent));
}

#[test]
fn a_node_that_starts_again_answers_no_more() {
    let (mut bench, mut client, _) = asking();
    let ended = client.restarted(&mut bench.at(Instant(11)), NodeId(0)).expect("an end");
    assert_eq!(ended.finished, Finished::Outcome(Outcome::PeerRestarted));
    assert!(client.restarted(&mut bench.at(Instant(11)), NodeId(0)).is_none());
}

#[test]
fn a_planted_fault_is_found() {
    let planted = |change: fn(&mut Outstanding)| {
        let (mut bench, mut client, threads) = asking();
        bench.own.now = Instant(13);
        change(&mut client.requests[0]);
        client.check(&bench.own, &threads)
    };
    use crate::ids::Seq24;
    assert_eq!(planted(|_| ()), Ok(()));
    assert_eq!(planted(|d| d.deadline = Instant(12)), Err(Violation::Overdue(Instant(12))));
    assert_eq!(planted(|d| d.copy_at = Instant(12)), Err(Violation::ResendInstant(MOVE)));
    assert_eq!(planted(|d| d.copies_left = 0), Err(Violation::ResendInstant(MOVE)));
    assert_eq!(planted(|d| d.phase = Phase::Closed), Err(Violation::WaitsForNothing(MOVE)));
    assert_eq!(planted(|d| d.phase = Phase::Ended), Err(Violation::WaitsForNothing(MOVE)));
    assert_eq!(
        planted(|d| d.recipients[0].id.sequence = Seq24::new(1)),
        Err(Violation::WaitsForNothing(MOVE))
    );
}
