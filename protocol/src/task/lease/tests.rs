use super::*;
use crate::task::fixture::{A, ALIVE, B, Fixture};
use crate::task::violation::Violation;

/// One side of the couple, after its first step at instant 5.
fn side(task: TaskId) -> (Fixture, Lease) {
    let mut bench = Fixture::new(task);
    let mut lease = Lease::new(&bench.table, &bench.own).expect("a couple");
    assert_eq!(lease.advance(&mut bench.at(Instant(5))), None);
    assert_eq!(lease.check(Instant(5)), Ok(()));
    (bench, lease)
}

/// Delivers all packets of one side to the other side. Returns the epoch if that side begins to act.
fn carry(from: &mut Fixture, (to, lease): (&mut Fixture, &mut Lease), now: Instant) -> Option<u8> {
    let table = to.table.clone();
    let port = table.port(ALIVE).unwrap();
    let packets = from.packets();
    packets.iter().filter_map(|packet| lease.hear(&mut to.at(now), port, packet)).last()
}

#[test]
fn an_echo_of_an_answer_gives_the_lease_and_silence_ends_it() {
    let ((mut a, mut primary), (mut b, mut standby)) = (side(A), side(B));
    assert_eq!(carry(&mut b, (&mut a, &mut primary), Instant(6)), None, "a beat is no echo");
    assert_eq!(carry(&mut a, (&mut b, &mut standby), Instant(7)), None);
    assert_eq!(standby.advance(&mut b.at(Instant(9))), None);
    // The epoch is odd, and above any in which an earlier incarnation of the partner may have acted.
    assert_eq!(carry(&mut b, (&mut a, &mut primary), Instant(10)), Some(3));
    // The lease counts from the answer, which was sent at instant 6.
    assert_eq!((primary.acts(), primary.left(Instant(10))), (true, Some(Ticks(10))));
    assert_eq!(primary.advance(&mut a.at(Instant(20))), None);
    assert_eq!((primary.acts(), primary.take_call()), (false, Some(Call::Fenced)));
    let takeover = standby.due_to_take_over();
    assert!(takeover > Instant(20), "not while the other may act: {takeover}");
    assert_eq!(standby.advance(&mut b.at(takeover)), Some(4));
    assert_eq!(standby.take_call(), Some(Call::TakeOver(4)));
}

#[test]
fn only_who_acts_sends_under_the_lease() {
    let (mut b, mut standby) = side(B);
    let go = Contents::new(b"go").unwrap();
    assert_eq!(standby.with_epoch(0, go), Err(Fault::Fenced));
    let epoch = standby.advance(&mut b.at(standby.due_to_take_over())).expect("it acts");
    assert_eq!(standby.with_epoch(0, go).unwrap().as_bytes(), [b'g', b'o', epoch]);
    assert_eq!(standby.with_epoch(1, go), Err(Fault::Fenced), "another couple");
    standby.retire();
    assert_eq!(standby.with_epoch(0, go), Err(Fault::Fenced));
}

#[test]
fn a_planted_fault_is_found() {
    let planted = |of: TaskId, change: fn(&mut Lease)| {
        let (_, mut lease) = side(of);
        change(&mut lease);
        lease.check(Instant(5))
    };
    assert_eq!(planted(A, |l| l.post = Post::Leased(Instant(5))), Err(Violation::PastLease(Instant(5))));
    assert_eq!(planted(A, |l| l.post = Post::Leased(Instant(6))), Ok(()));
    assert_eq!(planted(B, |l| l.takeover_at = Instant(4)), Err(Violation::PastLease(Instant(4))));
    let wrong = Err(Violation::WrongCall);
    assert_eq!(planted(B, |l| l.call = Some(Call::TakeOver(0))), wrong);
    assert_eq!(planted(B, |l| (l.post, l.call) = (Post::Alone, Some(Call::Fenced))), wrong);
    assert_eq!(planted(B, |l| (l.post, l.call) = (Post::Alone, Some(Call::TakeOver(7)))), wrong);
    assert_eq!(planted(B, |l| (l.post, l.call) = (Post::Alone, Some(Call::TakeOver(l.epoch)))), Ok(()));
    assert_eq!(planted(A, |l| l.call = Some(Call::Timer(crate::request::TimeId(0)))), wrong);
}

impl Lease {
    fn due_to_take_over(&self) -> Instant {
        self.takeover_at
    }
}
