//! Scenes of a task that is a future: it listens, and cancels what it asked.

use super::{DEADLOCK, must_fail};
use crate::clock::FAR;
use crate::explorer::{Arc, explore, thread};
use crate::sync::Word;
use crate::sync::handoff::{Handoff, Plant, Protected, Rest, ThreadWaker};

/// A machine whose task has asked, or not. As the real one, it confirms a cancellation even if there is no wait.
#[derive(Default)]
struct Asked {
    waits: bool,
    kept: u32,
}

#[derive(Clone, Copy)]
enum Brought {
    Question,
    Message,
    Cancel,
    Nothing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Got {
    Message,
    Cancelled,
}

impl Protected for Asked {
    type Input = Brought;
    type Completion = Got;
    type Effects = ();

    fn may_wait(input: &Brought) -> bool {
        matches!(input, Brought::Message)
    }

    fn feed(&mut self, input: Brought, (): &mut ()) -> Option<Got> {
        match input {
            Brought::Question => {
                self.waits = true;
                None
            }
            Brought::Message if std::mem::take(&mut self.waits) => Some(Got::Message),
            Brought::Message => {
                self.kept += 1;
                None
            }
            Brought::Cancel => {
                self.waits = false;
                Some(Got::Cancelled)
            }
            Brought::Nothing => None,
        }
    }

    fn settle(&mut self, _rest: Rest, (): &mut ()) -> u64 {
        FAR
    }
}

/// The word on which the executor sleeps.
struct Waker(Word);

impl ThreadWaker for Waker {
    fn wake(&self) {
        self.0.store(1);
        self.0.wake();
    }
}

fn of_a_future(plant: Option<Plant>) -> (Arc<Handoff<Asked, Option<Plant>>>, std::sync::Arc<Waker>) {
    let waker = std::sync::Arc::new(Waker(Word::new(0)));
    let rings = std::sync::Arc::clone(&waker) as std::sync::Arc<dyn ThreadWaker>;
    (Arc::new(Handoff::planted(Asked::default(), Some(rings), plant)), waker)
}

fn bring_a_message(handoff: &Arc<Handoff<Asked, Option<Plant>>>) -> thread::JoinHandle<()> {
    let handoff = Arc::clone(handoff);
    thread::spawn(move || handoff.deliver(Brought::Message, &mut ()))
}

/// The future asks and listens; another thread brings the message. Returns how often it was polled again. With `came_in` it has
/// entered as a thread does, like a future whose wait was dropped.
fn ask_and_listen(plant: Option<Plant>, came_in: bool) -> u32 {
    let (handoff, waker) = of_a_future(plant);
    let mut polls = 0;
    if came_in {
        handoff.enter(Brought::Nothing, &mut ());
    }
    let mut entry = handoff.enter_awake(Brought::Question, &mut ());
    let other = bring_a_message(&handoff);
    while entry.completion.is_none() {
        polls += 1;
        if handoff.listen() {
            while waker.0.load() == 0 {
                waker.0.wait(0, None);
            }
            waker.0.store(0);
        }
        entry = handoff.enter_awake(Brought::Nothing, &mut ());
    }
    other.join().unwrap();
    polls
}

#[test]
fn a_future_that_listens_is_woken() {
    let seen = explore(|| ask_and_listen(None, false));
    // The question finds no message yet, and the future is called once: no call is lost, and none is made twice.
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1], "{seen:?}");
}

#[test]
fn a_future_that_is_not_called_waits_for_ever() {
    must_fail(DEADLOCK, || ask_and_listen(Some(Plant::NoWaker), false));
    must_fail(DEADLOCK, || ask_and_listen(Some(Plant::NoMark), false));
}

#[test]
fn a_future_sees_what_was_left_to_it_before_it_listens() {
    let seen = explore(|| ask_and_listen(None, true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1], "{seen:?}");
    must_fail(DEADLOCK, || ask_and_listen(Some(Plant::SleepsOnIt), true));
}

/// The future cancels its wait while another thread brings the message. Returns what it found.
fn give_up(blindly: bool) -> Got {
    let (handoff, _waker) = of_a_future(None);
    handoff.enter_awake(Brought::Question, &mut ());
    let other = bring_a_message(&handoff);
    let entry = if blindly {
        handoff.enter(Brought::Cancel, &mut ())
    } else {
        handoff.enter_awake(Brought::Cancel, &mut ())
    };
    other.join().unwrap();
    let got = entry.completion.expect("one or the other");
    let kept = handoff.look_at(|asked| asked.kept);
    assert_eq!(kept + u32::from(got == Got::Message), 1, "a message is gone");
    got
}

#[test]
fn a_message_for_a_wait_that_is_given_up_is_found_or_kept() {
    let seen = explore(|| give_up(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Got::Message, Got::Cancelled], "{seen:?}");
}

#[test]
fn a_wait_that_is_given_up_blindly_loses_a_message() {
    must_fail("a message is gone", || give_up(true));
}
