use super::timers::Started;
use super::*;
use crate::request::{Outcome, TimeId};
use crate::task::fixture::{B, Fixture};
use crate::task::violation::Violation;
use crate::ticks::Ticks;
use alloc::format;

const GET: Pending = Pending::Get { port: None, source: None, deadline: Instant::NEVER };
const ANSWERED: Finished = Finished::Outcome(Outcome::Refused);

#[test]
fn the_end_of_a_wait_below_a_handler_is_kept_until_the_handler_ends() {
    let bench = Fixture::new(B);
    let mut threads = Interrupts::default();
    threads.wait(Pending::Reply(0));
    threads.begin(&bench.own, 0);
    threads.wait(Pending::Work);
    assert!(!threads.conclude(Pending::Reply(0), &ANSWERED), "its thread does not run");
    assert!(threads.conclude(Pending::Work, &ANSWERED), "this one does");
    assert!(!threads.conclude(Pending::Work, &ANSWERED), "it waits no more");
    assert_eq!(threads.check(&bench.table, &bench.own, false), Ok(()));
    assert_eq!(threads.resume(), Ok(Some(ANSWERED)));
    assert_eq!(threads.resume(), Err(Fault::NotInterrupted));
}

#[test]
fn a_thread_between_two_statements_stands_at_a_boundary_while_a_handler_runs() {
    let bench = Fixture::new(B);
    let mut threads = Interrupts::default();
    assert!(!threads.is_interruptible(false, false) && threads.is_interruptible(true, false));
    threads.begin(&bench.own, 0);
    assert_eq!(threads.resume(), Ok(None));
    assert_eq!(threads.pending(), Pending::Boundary);
}

#[test]
fn in_an_atomic_section_only_the_lease_interrupts() {
    let mut threads = Interrupts::default();
    threads.set_atomic(true);
    threads.wait(Pending::Work);
    assert!(!threads.is_interruptible(false, false) && threads.is_interruptible(false, true));
}

#[test]
fn what_a_timer_s_earlier_start_says_is_stale() {
    let mut bench = Fixture::new(B);
    let mut threads = Interrupts::default();
    let id = TimeId(3);
    threads.start(id, Ticks(5), bench.at(Instant(1)).out).unwrap();
    threads.start(id, Ticks(7), bench.at(Instant(2)).out).unwrap();
    assert_eq!(bench.effects.armed, [(id, 0, Ticks(5)), (id, 1, Ticks(7))]);
    assert!(!threads.time_is_over(id, 0));
    assert!(!threads.has_ended_timer());
    assert!(!threads.time_is_over(id, 1));
    assert!(threads.has_ended_timer());
    threads.wait(GET);
    let offer = threads.first_timer(&bench.table, &bench.own).expect("an offer");
    let What::Timer(at) = offer.what else { panic!("a timer") };
    assert_eq!(threads.take_timer(at), id);
    threads.stop(id, bench.at(Instant(9)).out);
    assert!(bench.effects.disarmed.is_empty(), "it was over");
}

/// The violation that `check` finds after a fault was planted.
fn planted(fault: impl FnOnce(&mut Interrupts)) -> Violation {
    let mut bench = Fixture::new(B);
    bench.own.now = Instant(10);
    let mut threads = Interrupts::default();
    threads.wait(Pending::Work);
    assert_eq!(threads.check(&bench.table, &bench.own, false), Ok(()));
    fault(&mut threads);
    threads.check(&bench.table, &bench.own, false).unwrap_err()
}

#[test]
fn a_planted_fault_is_found() {
    assert_eq!(planted(|t| t.depth = 11), Violation::Levels(11));
    assert_eq!(planted(|t| t.running.finished = Some(Finished::Answers(0))), Violation::Levels(0));
    let two = planted(|t| {
        t.depth = 2;
        t.interrupted[0] = t.running;
        t.interrupted[1] = Activation { rank: 1, pending: Pending::Work, ..Activation::NEW };
        t.running = Activation { rank: 2, ..Activation::NEW };
    });
    assert_eq!(two, Violation::Levels(2));
    let late = planted(|t| t.wait(Pending::Get { port: None, source: None, deadline: Instant(9) }));
    assert_eq!(late, Violation::Overdue(Instant(9)));
    let started = Some(Started { id: TimeId(7), turn: 0 });
    let named = planted(|t| t.timers.slots = [started; TIMERS]);
    let over = planted(|t| {
        (t.timers.slots[1], t.timers.ended) = (started, 0b10);
        t.wait(GET);
    });
    assert_eq!([named, over], [Violation::Timers(TimeId(7)), Violation::TimerNotOffered(TimeId(7))]);
    for violation in [two, named, over] {
        assert!(format!("{violation}").len() > 20, "{violation}");
    }
}

#[test]
fn threads_and_timers_that_were_read_are_bounded() {
    let is_whole = |change: fn(&mut Interrupts)| {
        let mut threads = Interrupts::default();
        change(&mut threads);
        threads.is_whole(|_| true)
    };
    assert!(is_whole(|_| ()));
    assert!(!is_whole(|t| t.depth = DEPTH as u8 + 1));
    assert!(!is_whole(|t| t.interrupted = Box::default()));
    assert!(!is_whole(|t| t.timers.ended = 0b100), "a timer is over that there is not");
}
