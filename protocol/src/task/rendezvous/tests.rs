use super::*;
use crate::packet::{Kind, Meeting, Packet};
use crate::task::fixture::{A, B, Fixture, LIFT};
use crate::task::interrupts::Interrupts;
use crate::task::violation::Violation;
use crate::task::wait::{Ended, Finished, Pending};
use alloc::format;

/// A fixture in which a task has waited at the waitfor since instant 10, with a patience of 30.
fn waiting(task: TaskId) -> (Fixture, Meetings, Interrupts) {
    let mut bench = Fixture::new(task);
    let (mut meetings, mut threads) = (Meetings::new(&bench.table, &bench.own), Interrupts::default());
    threads.wait(Pending::Meeting(0));
    assert_eq!(meetings.reach(&mut bench.at(Instant(10)), 0, ([task.0 as u8; 8], Ticks(30))), None);
    assert_eq!(meetings.check(&bench.table, &bench.own, &threads), Ok(()));
    (bench, meetings, threads)
}

fn ended(finished: Finished) -> Ended {
    Ended { wait: Some(Pending::Meeting(0)), finished }
}

fn hear(bench: &mut Fixture, meetings: &mut Meetings, now: u64, packet: &Packet) -> Option<Ended> {
    let table = bench.table.clone();
    let from = Fixture::ends(&table, packet).peer;
    meetings.hear(&mut bench.at(Instant(now)), 0, (from, packet))
}

#[test]
fn both_are_released_in_one_round_by_each_other_s_arrival() {
    let (mut a, mut of_a, _) = waiting(A);
    let (mut b, mut of_b, _) = waiting(B);
    let (from_a, from_b) = (a.packets()[0], b.packets()[0]);
    let released = ended(Finished::Released { port: LIFT, round: Round(1), by: ReleasedBy::AllArrived });
    assert_eq!(hear(&mut a, &mut of_a, 12, &from_b), Some(released));
    assert_eq!(hear(&mut b, &mut of_b, 13, &from_a), Some(released));
    let port = a.table.port(LIFT).unwrap();
    assert_eq!(of_a.at(0).told(port, B), Some([1; 8]));
    assert_eq!(hear(&mut a, &mut of_a, 14, &from_b), None, "a copy of it is answered, no more");
    assert_eq!(a.packets().last().unwrap().kind, Kind::Confirm);
}

#[test]
fn a_confirm_of_the_round_releases_and_one_of_another_does_not() {
    let (mut a, mut of_a, _) = waiting(A);
    let (mut b, mut of_b, _) = waiting(B);
    hear(&mut b, &mut of_b, 12, &a.packets()[0]);
    let confirm = *b.packets().iter().find(|packet| packet.kind == Kind::Confirm).expect("a CONFIRM");
    let other = Meeting { round: Round(7), released: Round(7), arguments: [0; 8] };
    let wrong = Packet { contents: other.to_contents(), ..confirm };
    assert_eq!(hear(&mut a, &mut of_a, 13, &wrong), None);
    let by = ReleasedBy::Confirm(B);
    let released = ended(Finished::Released { port: LIFT, round: Round(1), by });
    assert_eq!(hear(&mut a, &mut of_a, 13, &confirm), Some(released));
}

#[test]
fn whose_patience_ends_tells_the_others_and_who_was_missing() {
    let (mut a, mut of_a, _) = waiting(A);
    a.packets();
    let mut end = None;
    while end.is_none() {
        let due = of_a.next_act();
        assert!(due <= Instant(40));
        end = of_a.advance(&mut a.at(due), 0).and_then(|(_, ended)| Some((due, ended?)));
    }
    // B owns the port, so it is the first party.
    let gave_up = ended(Finished::GaveUp { port: LIFT, round: Round(1), missing: 1 });
    assert_eq!(end, Some((Instant(40), gave_up)));
    assert_eq!(a.packets().last().unwrap().kind, Kind::Abort);
}

#[test]
fn a_planted_fault_is_found() {
    let planted = |change: fn(&mut Rendezvous)| {
        let (bench, mut meetings, threads) = waiting(B);
        change(&mut meetings.list[0]);
        meetings.check(&bench.table, &bench.own, &threads).unwrap_err()
    };
    let (bench, meetings, mut threads) = waiting(B);
    threads.end_wait();
    let differ = Violation::MeetingAndWaitDiffer(LIFT);
    assert_eq!(meetings.check(&bench.table, &bench.own, &threads), Err(differ));
    assert_eq!(planted(|m| m.deadline = None), differ);
    assert_eq!(planted(|m| m.deadline = Some(Instant(9))), Violation::Overdue(Instant(9)));
    assert_eq!(planted(|m| m.resend_at = Instant(15)), Violation::ResendInstant(LIFT));
    assert_eq!(planted(|m| m.copy_at = Instant(15)), Violation::ResendInstant(LIFT));
    assert_eq!(planted(|m| m.fresh = Round(0)), Violation::Rounds(LIFT));
    assert_eq!(planted(|m| m.released = Some(Round(2))), Violation::Rounds(LIFT));
    assert_eq!(planted(|m| m.owes_confirm = true), Violation::OwesConfirm(LIFT));
    assert_eq!(planted(|m| (m.copies_left, m.copy_at) = (1, Instant(12))), Violation::OutOfOrder(LIFT));
    let barred = planted(|m| {
        m.members[1].arrived = Some(Arrived { round: Round(1), expires: Instant(50), arguments: [0; 8] });
        m.members[1].barred = Some(Round(1));
    });
    assert_eq!(barred, Violation::HoldsBarred(LIFT, A, Round(1)));
    assert_eq!(format!("{barred}"), "waitfor P1 counts the arrival of T0 in r1, which it gave up");
}
