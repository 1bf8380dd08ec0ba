//! Every interleaving of the hand-offs with at most three preemptions, by loom. In this build the locks and atomics of [`crate::sync`] are loom's.
//!
//! Each test asserts which outcomes were seen, and has a twin with a planted bug that must be found: an exploration
//! that sees one outcome or misses the bug shows nothing.

use crate::alarm::Alarm;
use crate::clock::FAR;
use crate::handoff::{Handoff, Plant, Rest, Station};
use crate::turn::Turn;
use loom::sync::Arc;
use loom::thread;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex as StdMutex;
use std::time::{Duration, Instant};

/// An exploration that takes longer shows nothing and fails.
const CAP: Duration = Duration::from_secs(120);

/// How often each outcome was seen.
type Histogram<O> = BTreeMap<O, u64>;

/// Runs `body` in every interleaving with at most three preemptions.
fn explore<O: Ord + Send + 'static>(body: impl Fn() -> O + Send + Sync + 'static) -> Histogram<O> {
    let seen = std::sync::Arc::new(StdMutex::new(Histogram::new()));
    let shared = std::sync::Arc::clone(&seen);
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(3);
    builder.max_duration = Some(CAP);
    let start = Instant::now();
    builder.check(move || {
        let outcome = body();
        *shared.lock().unwrap().entry(outcome).or_insert(0) += 1;
    });
    assert!(start.elapsed() < CAP, "the exploration did not end");
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    assert!(seen.values().sum::<u64>() > 1, "only one execution was explored");
    seen
}

/// Expects that the exploration finds a planted bug, by its symptom.
fn must_fail<O: Ord + Send + 'static>(symptom: &str, body: impl Fn() -> O + Send + Sync + 'static) {
    let Err(panic) = catch_unwind(AssertUnwindSafe(|| explore(body))) else {
        panic!("the planted bug was not found");
    };
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string)).unwrap_or_default();
    assert!(text.contains(symptom), "another failure than the planted one: {text}");
}

/// What loom says when every thread sleeps.
const DEADLOCK: &str = "deadlock";

/// A machine of two states: its task has asked, or not. It keeps an answer that comes before the question.
#[derive(Default)]
struct Toy {
    asked: bool,
    kept: u32,
    fed: u32,
}

#[derive(Clone, Copy)]
enum Brought {
    Question,
    Answer,
    TimeIsUp,
    Nothing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Got {
    Answer,
    TimedOut,
}

impl Station for Toy {
    type Input = Brought;
    type Mail = Got;
    /// How many inputs this thread has worked off.
    type Effects = u32;

    fn feed(&mut self, input: Brought, worked: &mut u32) -> Option<Got> {
        self.fed += 1;
        *worked += 1;
        match input {
            Brought::Question if self.kept > 0 => {
                self.kept -= 1;
                Some(Got::Answer)
            }
            Brought::Question => {
                self.asked = true;
                None
            }
            Brought::Answer if self.asked => {
                self.asked = false;
                Some(Got::Answer)
            }
            Brought::Answer => {
                self.kept += 1;
                None
            }
            Brought::TimeIsUp if self.asked => {
                self.asked = false;
                Some(Got::TimedOut)
            }
            Brought::TimeIsUp | Brought::Nothing => None,
        }
    }

    fn settle(&mut self, _rest: Rest, _worked: &mut u32) -> u64 {
        FAR
    }
}

fn toy(plant: Plant) -> Arc<Handoff<Toy>> {
    let mut handoff = Handoff::new(Toy::default());
    handoff.plant = plant;
    Arc::new(handoff)
}

fn bring(handoff: &Arc<Handoff<Toy>>, input: Brought) -> thread::JoinHandle<u32> {
    let handoff = Arc::clone(handoff);
    thread::spawn(move || {
        let mut worked = 0;
        handoff.deliver(input, &mut worked);
        worked
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Waited {
    /// The answer was there.
    NotAtAll,
    /// It came between the look and the sleep.
    Awake,
    Asleep,
}

/// The task asks and waits; another thread brings the answer. If it is not told of it, loom finds the deadlock.
fn ask_and_wait(plant: Plant) -> Waited {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut waited = Waited::NotAtAll;
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    while entry.mail.is_none() {
        waited = if handoff.sleep(None) { Waited::Asleep } else { Waited::Awake };
        entry = handoff.enter(Brought::Nothing, &mut worked);
    }
    other.join().unwrap();
    waited
}

#[test]
fn an_answer_always_ends_the_wait() {
    let seen = explore(|| ask_and_wait(Plant::None));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [Waited::NotAtAll, Waited::Awake, Waited::Asleep], "{seen:?}");
}

#[test]
fn a_word_that_is_not_marked_loses_the_wake_up() {
    must_fail(DEADLOCK, || ask_and_wait(Plant::NoMark));
}

#[test]
fn a_sleeper_that_is_not_woken_sleeps_for_ever() {
    must_fail(DEADLOCK, || ask_and_wait(Plant::NoWake));
}

/// Two threads bring input at once. How much one of them worked off, at the most.
fn two_bring(plant: Plant) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut own = 0;
    handoff.deliver(Brought::Answer, &mut own);
    let others = other.join().unwrap();
    let (worked, mut own) = (own, own);
    assert_eq!(handoff.with(|toy| toy.fed, &mut own), 2, "input stayed behind");
    worked.max(others)
}

#[test]
fn whoever_holds_the_lock_works_for_all() {
    let seen = explore(|| two_bring(Plant::None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn without_a_second_look_input_stays_behind() {
    must_fail("input stayed behind", || two_bring(Plant::NoSecondLook));
}

/// One thread looks while another brings input. Whether the one who looks had to work.
fn one_looks(plant: Plant) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut worked = 0;
    handoff.with(|_| (), &mut worked);
    assert_eq!(worked + other.join().unwrap(), 1, "input stayed behind");
    worked
}

#[test]
fn whoever_only_looks_still_works_off_what_was_left() {
    let seen = explore(|| one_looks(Plant::None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1], "{seen:?}");
}

#[test]
fn looking_without_a_second_look_leaves_input_behind() {
    must_fail("input stayed behind", || one_looks(Plant::NoSecondLook));
}

/// One thread leaves input and nudges while another brings some. How much the one who left it worked off.
fn one_leaves(plant: Plant) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut worked = 0;
    assert!(handoff.leave(Brought::Answer).is_ok(), "the inbox has room");
    handoff.nudge(&mut worked);
    assert_eq!(worked + other.join().unwrap(), 2, "input stayed behind");
    worked
}

#[test]
fn what_was_left_is_worked_off() {
    let seen = explore(|| one_leaves(Plant::None));
    assert!(seen.contains_key(&0) && seen.contains_key(&1), "{seen:?}");
}

#[test]
fn a_nudge_without_a_look_leaves_input_behind() {
    must_fail("input stayed behind", || one_leaves(Plant::NoSecondLook));
}

/// The answer comes while the time runs out. The outcome is decided once, under the lock: never both, never neither.
/// `under_lock` false is the bug: the task takes its time as over without looking.
fn race_with_time(under_lock: bool) -> Got {
    let handoff = toy(Plant::None);
    let answer = bring(&handoff, Brought::Answer);
    let kernel = Arc::clone(&handoff);
    let time = thread::spawn(move || kernel.time_out());
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    let got = loop {
        if let Some(got) = entry.mail {
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
    let (asked, kept) = handoff.with(|toy| (toy.asked, toy.kept), &mut worked);
    assert!(!asked, "the question is still open");
    assert_eq!(kept, u32::from(got == Got::TimedOut), "the answer was lost or taken twice");
    got
}

#[test]
fn a_reply_and_a_time_out_are_decided_once() {
    let seen = explore(|| race_with_time(true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Got::Answer, Got::TimedOut], "{seen:?}");
}

#[test]
fn a_time_out_decided_outside_the_lock_loses_an_answer() {
    must_fail("lost or taken twice", || race_with_time(false));
}

/// The node stops while a task waits and its answer comes.
fn stop_while_waiting(plant: Plant, with_answer: bool) -> Option<Got> {
    let handoff = toy(plant);
    let answer = with_answer.then(|| bring(&handoff, Brought::Answer));
    let stopper = Arc::clone(&handoff);
    let stop = thread::spawn(move || stopper.stop(&mut 0));
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    while entry.mail.is_none() && !entry.stopped {
        handoff.sleep(None);
        entry = handoff.enter(Brought::Nothing, &mut worked);
    }
    stop.join().unwrap();
    if let Some(answer) = answer {
        answer.join().unwrap();
    }
    entry.mail
}

#[test]
fn stopping_ends_every_wait() {
    let seen = explore(|| stop_while_waiting(Plant::None, true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [None, Some(Got::Answer)], "{seen:?}");
}

#[test]
fn stopping_silently_leaves_a_sleeper_behind() {
    must_fail(DEADLOCK, || stop_while_waiting(Plant::SilentStop, false));
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Found {
    AtOnce,
    AfterSleep,
}

/// The Timer thread has served one expiry and looks for the next while another thread publishes one.
fn publish_while_looking(buggy: bool) -> Found {
    let mut alarm = Alarm::new(2);
    alarm.no_open_target = buggy;
    let alarm = Arc::new(alarm);
    alarm.publish(1, 3);
    assert_eq!(alarm.earliest().at, 3);
    let publisher = Arc::clone(&alarm);
    let other = thread::spawn(move || publisher.publish(0, 5));
    alarm.publish(1, FAR);
    let mut found = Found::AtOnce;
    loop {
        let earliest = alarm.earliest();
        if earliest.at == 5 {
            break;
        }
        alarm.sleep(earliest);
        found = Found::AfterSleep;
    }
    other.join().unwrap();
    found
}

#[test]
fn the_timer_thread_hears_of_every_expiry() {
    let seen = explore(|| publish_while_looking(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Found::AtOnce, Found::AfterSleep], "{seen:?}");
}

#[test]
fn a_target_that_is_not_opened_hides_an_expiry() {
    must_fail(DEADLOCK, || publish_while_looking(true));
}

/// Two threads put something down and take a turn to carry it away. How much one of them carried, at the most.
fn two_take_turns(buggy: bool) -> u32 {
    fn put_and_take(turn: &Turn<()>, pile: &loom::sync::Mutex<u32>) -> u32 {
        *pile.lock().unwrap() += 1;
        turn.want();
        let mut carried = 0;
        turn.take(|()| carried += std::mem::take(&mut *pile.lock().unwrap()));
        carried
    }
    let mut turn = Turn::new(());
    turn.leaves_blindly = buggy;
    let shared = Arc::new((turn, loom::sync::Mutex::new(0)));
    let theirs = Arc::clone(&shared);
    let other = thread::spawn(move || put_and_take(&theirs.0, &theirs.1));
    let own = put_and_take(&shared.0, &shared.1);
    let others = other.join().unwrap();
    assert_eq!(own + others, 2, "something was left lying");
    own.max(others)
}

#[test]
fn nothing_is_left_lying_by_those_who_found_another_at_work() {
    let seen = explore(|| two_take_turns(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn leaving_without_another_look_leaves_something_lying() {
    must_fail("something was left lying", || two_take_turns(true));
}
