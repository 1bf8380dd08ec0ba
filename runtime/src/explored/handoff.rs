//! Scenes of the hand-off, which is the lock of a communication task with the inbox for its inputs: answers,
//! wake-ups, input that is left for the holder of the lock, time_outs, and stopping.

use super::{DEADLOCK, Listed, must_fail, must_fail_large};
use crate::clock::FAR;
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, explore_large, thread};
use crate::sync::handoff::{Handoff, Plant, Protected, Rest};

/// A state machine with two states: its task waits for an answer, or does not. The machine keeps an answer that comes
/// before the request.
#[derive(Default)]
pub(super) struct Toy {
    asked: bool,
    pub kept: u32,
    pub fed: u32,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Brought {
    Question,
    /// The task takes a kept answer without waiting.
    Poll,
    Answer,
    /// An answer arrives; its handling may wait until the task's own thread takes it.
    News,
    TimeIsUp,
    Nothing,
}

impl Listed for Brought {
    const ALL: &[Self] =
        &[Self::Question, Self::Poll, Self::Answer, Self::News, Self::TimeIsUp, Self::Nothing];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Got {
    Answer,
    TimedOut,
}

impl Protected for Toy {
    type Input = Brought;
    type Completion = Got;
    /// How many inputs this thread has handled.
    type Effects = u32;

    fn may_wait(input: &Brought) -> bool {
        matches!(input, Brought::News)
    }

    fn feed(&mut self, input: &mut Brought, worked: &mut u32) -> Option<Got> {
        self.fed += 1;
        *worked += 1;
        match input {
            Brought::Question | Brought::Poll if self.kept > 0 => {
                self.kept -= 1;
                Some(Got::Answer)
            }
            Brought::Question => {
                self.asked = true;
                None
            }
            Brought::Answer | Brought::News if self.asked => {
                self.asked = false;
                Some(Got::Answer)
            }
            Brought::Answer | Brought::News => {
                self.kept += 1;
                None
            }
            Brought::TimeIsUp if self.asked => {
                self.asked = false;
                Some(Got::TimedOut)
            }
            Brought::Poll | Brought::TimeIsUp | Brought::Nothing => None,
        }
    }

    fn settle(&mut self, _rest: Rest, _worked: &mut u32) -> u64 {
        FAR
    }
}

pub(super) fn toy(plant: Option<Plant>) -> Arc<Handoff<Toy, Option<Plant>>> {
    Arc::new(Handoff::planted(Toy::default(), None, plant))
}

pub(super) fn bring(handoff: &Arc<Handoff<Toy, Option<Plant>>>, input: Brought) -> thread::JoinHandle<u32> {
    let handoff = Arc::clone(handoff);
    thread::spawn(move || {
        let mut worked = 0;
        handoff.deliver(input, &mut worked);
        worked
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Waited {
    /// The task did not wait: there was an answer already.
    NotAtAll,
    /// The task's thread found the answer while it was spinning.
    Looking,
    /// The answer came after the task's thread had last looked for it, and before the thread slept.
    Awake,
    Asleep,
}

/// The task makes a request. Until there is an answer, its thread calls `look`, which returns whether it found one,
/// and then sleeps. Returns how the task waited, and the answer.
pub(super) fn ask(handoff: &Handoff<Toy, Option<Plant>>, look: impl Fn() -> bool) -> (Waited, Got) {
    let (mut waited, mut worked) = (Waited::NotAtAll, 0);
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    loop {
        if let Some(answer) = entry.completion {
            return (waited, answer);
        }
        waited = if look() {
            Waited::Looking
        } else if handoff.sleep(None) {
            Waited::Asleep
        } else {
            Waited::Awake
        };
        entry = handoff.come_back_and(Brought::Nothing, |_| None, &mut worked);
    }
}

/// The task makes a request, checks for the answer `looks` times and then sleeps; another thread brings the answer.
/// If that thread does not wake the task, loom finds the deadlock. Returns how the task waited, and whether its
/// thread handled the answer itself.
fn ask_and_wait(plant: Option<Plant>, looks: u32) -> (Waited, bool) {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let (waited, _) = ask(&handoff, || handoff.look(|| false, |there| (0..looks).any(|_| there())));
    (waited, other.join().unwrap() == 0)
}

#[test]
fn an_answer_always_ends_the_wait() {
    let seen = explore(|| ask_and_wait(None, 0));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let expected = [
        (Waited::NotAtAll, false),
        (Waited::NotAtAll, true),
        (Waited::Awake, false),
        (Waited::Awake, true),
        (Waited::Asleep, false),
    ];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn a_word_that_is_not_marked_loses_the_wake_up() {
    must_fail(DEADLOCK, || ask_and_wait(Some(Plant::NoMark), 0));
}

#[test]
fn a_sleeper_that_is_not_woken_sleeps_for_ever() {
    must_fail(DEADLOCK, || ask_and_wait(Some(Plant::NoWake), 0));
}

#[test]
fn who_looks_before_it_sleeps_misses_no_answer() {
    let seen = explore(|| ask_and_wait(None, 2));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let expected = [
        (Waited::NotAtAll, false),
        (Waited::NotAtAll, true),
        (Waited::Looking, false),
        (Waited::Looking, true),
        (Waited::Awake, false),
        (Waited::Awake, true),
        (Waited::Asleep, false),
    ];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn who_leaves_something_and_does_not_see_that_nobody_looks_any_more_leaves_it_for_ever() {
    must_fail(DEADLOCK, || ask_and_wait(Some(Plant::TrustsTheLook), 1));
}

#[test]
fn without_its_fence_what_was_left_to_a_thread_that_looked_is_not_seen() {
    if SEES_OLD_VALUES {
        must_fail(DEADLOCK, || ask_and_wait(Some(Plant::NoFenceForARunner), 1));
    }
}

#[test]
fn a_sleep_that_trusts_the_last_look_misses_the_answer() {
    must_fail(DEADLOCK, || ask_and_wait(Some(Plant::SleepsBlindly), 2));
}

/// The answer comes just as the task's time runs out. The lock's holder decides the outcome once: it is one of the
/// two. If `under_lock` is false, a bug is planted: the task assumes that its time is over, and does not check this
/// under the lock.
fn race_with_time(under_lock: bool) -> Got {
    let handoff = toy(None);
    let answer = bring(&handoff, Brought::Answer);
    let kernel = Arc::clone(&handoff);
    let time = thread::spawn(move || kernel.time_out());
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    let got = loop {
        if let Some(got) = entry.completion {
            break got;
        }
        handoff.sleep(Some(1));
        if !under_lock {
            break Got::TimedOut;
        }
        entry = handoff.enter(Brought::TimeIsUp, &mut worked);
    };
    answer.join().unwrap();
    time.join().unwrap();
    let (asked, kept) = handoff.look_at(|toy| (toy.asked, toy.kept));
    assert!(!asked, "the question is still open");
    assert_eq!(kept, u32::from(got == Got::TimedOut), "the answer was lost or taken twice");
    got
}

#[test]
fn a_reply_and_a_time_out_are_decided_once() {
    let seen = explore_large(|| race_with_time(true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Got::Answer, Got::TimedOut], "{seen:?}");
}

#[test]
fn a_time_out_decided_outside_the_lock_loses_an_answer() {
    must_fail_large("lost or taken twice", || race_with_time(false));
}

/// The node stops while a task waits and its answer comes.
fn stop_while_waiting(plant: Option<Plant>, with_answer: bool) -> Option<Got> {
    let handoff = toy(plant);
    let answer = with_answer.then(|| bring(&handoff, Brought::Answer));
    let stopper = Arc::clone(&handoff);
    let stop = thread::spawn(move || stopper.stop(&mut 0));
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    while entry.completion.is_none() && !entry.stopped {
        handoff.sleep(None);
        entry = handoff.enter(Brought::Nothing, &mut worked);
    }
    stop.join().unwrap();
    if let Some(answer) = answer {
        answer.join().unwrap();
    }
    entry.completion
}

#[test]
fn stopping_ends_every_wait() {
    let seen = explore_large(|| stop_while_waiting(None, true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [None, Some(Got::Answer)], "{seen:?}");
}

#[test]
fn stopping_silently_leaves_a_sleeper_behind() {
    must_fail_large(DEADLOCK, || stop_while_waiting(Some(Plant::SilentStop), false));
}
