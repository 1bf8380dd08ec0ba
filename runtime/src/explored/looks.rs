//! Scenes of observers that look at a state machine while it works, and of a report that a packet
//! expired, which must reach the packet's sender before that sender decides.

use super::{Listed, must_fail};
use crate::clock::FAR;
use crate::explorer::{Arc, explore, thread};
use crate::observe::ring::Ring;
use crate::sync::handoff::{Handoff, Protected, Rest};
use crate::sync::inbox::Slotted;
use crate::sync::{AtomicU64, Mutex, Ordering, lock};
use imrs_protocol::{Event, Observation, PortId, TaskId, Ticks};

/// A state machine that counts what it observes.
struct Observed {
    ring: Ring,
    count: u32,
}

impl Listed for () {
    const ALL: &[Self] = &[()];
}

impl Protected for Observed {
    type Input = ();
    type Completion = ();
    type Effects = ();

    fn may_wait(_input: &()) -> bool {
        false
    }

    fn feed(&mut self, (): &mut (), (): &mut ()) -> Option<()> {
        let what = Observation {
            event: Event::Sent,
            port: PortId(0),
            peer: TaskId(0),
            number: self.count,
            remaining: Ticks(1),
        };
        self.ring.push(0, what);
        self.count += 1;
        None
    }

    fn settle(&mut self, _rest: Rest, (): &mut ()) -> u64 {
        FAR
    }
}

/// A state machine makes three observations while an observer follows, in a ring that keeps two. The observer reads
/// observations in order; those and the lost ones are three together. Returns how many were lost.
fn follow(forgets_the_loss: bool) -> u64 {
    let mut ring = Ring::of(2);
    ring.forgets_the_loss = forgets_the_loss;
    let handoff = Arc::new(Handoff::new(Observed { ring, count: 0 }, None));
    let mut from = handoff.with(|observed| observed.ring.subscribe(), &mut ());
    let writer = Arc::clone(&handoff);
    let other = thread::spawn(move || (0..3).for_each(|_| writer.deliver((), &mut ())));
    let (mut expected, mut lost) = (0, 0);
    let mut read = || {
        let mut numbers = [None; 3];
        let mut slots = numbers.iter_mut();
        let each = |_, what: Observation| *slots.next().unwrap() = Some(what.number);
        let (next, gone) = handoff.with(|observed| observed.ring.read(from, 3, each), &mut ());
        (from, expected, lost) = (next, expected + gone, lost + gone);
        for number in numbers.into_iter().flatten() {
            assert_eq!(u64::from(number), expected, "out of order");
            expected += 1;
        }
    };
    read();
    other.join().unwrap();
    read();
    assert_eq!(expected, 3, "an observation is neither read nor lost");
    lost
}

#[test]
fn whoever_follows_reads_in_order_and_knows_what_it_lost() {
    let seen = explore(|| follow(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1], "{seen:?}");
}

#[test]
fn a_reader_that_does_not_know_its_loss_reads_out_of_order() {
    must_fail("out of order", || follow(true));
}

/// A state machine that stamps each step with a time, and reports it.
struct Stamper {
    clock: Arc<AtomicU64>,
    told: [Option<u64>; 2],
    count: usize,
}

/// An input. Its stamp is set only if the bug is planted: the thread that brings the input then read the clock before
/// it had the lock. Without the bug, the state machine stamps its step by the clock under the lock.
struct Stamped(Option<u64>);

impl Slotted for Stamped {
    type Words = [u64; 1];
    type Atomics = [AtomicU64; 1];

    fn atomics() -> [AtomicU64; 1] {
        [AtomicU64::new(0)]
    }

    fn to_words(&self) -> Option<[u64; 1]> {
        Some([self.0.map_or(0, |at| at + 1)])
    }

    fn of_words(&[word]: &[u64; 1]) -> Self {
        Self(word.checked_sub(1))
    }
}

/// Reads the clock; each reading advances it.
fn read(clock: &AtomicU64) -> u64 {
    clock.fetch_add(1, Ordering::AcqRel)
}

impl Protected for Stamper {
    type Input = Stamped;
    type Completion = ();
    type Effects = ();

    fn may_wait(_input: &Stamped) -> bool {
        false
    }

    fn feed(&mut self, Stamped(brought): &mut Stamped, (): &mut ()) -> Option<()> {
        let at = brought.unwrap_or_else(|| read(&self.clock));
        self.told[self.count] = Some(at);
        self.count += 1;
        None
    }

    fn settle(&mut self, _rest: Rest, (): &mut ()) -> u64 {
        FAR
    }
}

/// A state machine reports steps, while an observer asks up to which instant all steps are reported. No step that is
/// reported later may be older than the observer's answer. Returns how many steps were reported before it.
fn told_until(stamped_outside: bool) -> usize {
    let clock = Arc::new(AtomicU64::new(0));
    let stamper = Stamper { clock: Arc::clone(&clock), told: [None; 2], count: 0 };
    let handoff = Arc::new(Handoff::new(stamper, None));
    let (theirs, machine) = (Arc::clone(&clock), Arc::clone(&handoff));
    let other = thread::spawn(move || {
        for _ in 0..2 {
            let brought = stamped_outside.then(|| read(&theirs));
            machine.deliver(Stamped(brought), &mut ());
        }
    });
    let now = read(&clock);
    let before = handoff.with(|stamper| stamper.count, &mut ());
    other.join().unwrap();
    let told = handoff.with(|stamper| stamper.told, &mut ());
    let after = told.iter().skip(before).flatten();
    after.for_each(|&at| assert!(at > now, "told too late"));
    before
}

#[test]
fn nothing_is_told_later_with_an_earlier_time() {
    let seen = explore(|| told_until(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1, 2], "{seen:?}");
}

#[test]
fn a_stamp_from_outside_the_lock_is_told_too_late() {
    must_fail("told too late", || told_until(true));
}

/// A state machine that waits until it learns whether its packet was sent.
#[derive(Default)]
struct Sender {
    outcome: Option<Outcome>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    Unsent,
    Unknown,
}

impl Listed for Outcome {
    const ALL: &[Self] = &[Self::Unsent, Self::Unknown];
}

impl Protected for Sender {
    type Input = Outcome;
    type Completion = Outcome;
    type Effects = ();

    fn may_wait(_input: &Outcome) -> bool {
        false
    }

    fn feed(&mut self, outcome: &mut Outcome, (): &mut ()) -> Option<Outcome> {
        self.outcome.is_none().then(|| *self.outcome.insert(*outcome))
    }

    fn settle(&mut self, _rest: Rest, (): &mut ()) -> u64 {
        FAR
    }
}

/// A packet expires in the buffer when its sender's time_out ends. The thread that drops the packet leaves a note for
/// the sender, and the sender checks the buffer before it decides. The planted bug: the thread leaves the note after
/// it has released the buffer's lock. Returns whether the sender dropped the packet itself.
fn expire_in_the_buffer(news_comes_late: bool) -> bool {
    fn advance(buffer: &Mutex<bool>, handoff: &Handoff<Sender>, news_comes_late: bool) -> bool {
        let mut held = lock(buffer);
        let dropped = std::mem::take(&mut *held);
        let held = (!news_comes_late).then_some(held);
        if dropped {
            assert!(handoff.leave(Outcome::Unsent).is_ok(), "the inbox has room");
        }
        drop(held);
        dropped
    }
    let shared = Arc::new((Mutex::new(true), Handoff::new(Sender::default(), None)));
    let theirs = Arc::clone(&shared);
    let other = thread::spawn(move || {
        advance(&theirs.0, &theirs.1, news_comes_late);
        theirs.1.wake(&mut ());
    });
    let own = advance(&shared.0, &shared.1, news_comes_late);
    let outcome = shared.1.enter(Outcome::Unknown, &mut ()).completion;
    assert_eq!(outcome, Some(Outcome::Unsent), "the news came too late");
    other.join().unwrap();
    own
}

#[test]
fn the_sender_knows_that_its_packet_never_left() {
    let seen = explore(|| expire_in_the_buffer(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
}

#[test]
fn news_after_the_buffer_was_let_go_comes_too_late() {
    must_fail("the news came too late", || expire_in_the_buffer(true));
}
