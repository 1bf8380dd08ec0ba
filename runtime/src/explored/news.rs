//! Scenes of inputs that may wait until a running task's own thread takes them (here called *news*), and of
//! inputs that may not.

use super::handoff::{Brought, Waited, ask, bring, toy};
use super::{DEADLOCK, must_fail};
use crate::explorer::{SEES_OLD_VALUES, explore};
use crate::sync::handoff::Plant;

/// A task has used its state machine before. It makes a request, checks for the answer `looks` times and then sleeps;
/// another thread brings news, which may wait. Returns how the task waited, and whether its own thread handled the
/// news.
fn ask_for_news(plant: Option<Plant>, looks: u32) -> (Waited, bool) {
    let handoff = toy(plant);
    handoff.enter(Brought::Nothing, &mut 0);
    let other = bring(&handoff, Brought::News);
    let look = || looks > 0 && handoff.look(|| false, |there| (0..looks).any(|_| there()));
    let (waited, _) = ask(&handoff, look);
    (waited, other.join().unwrap() == 0)
}

/// Asserts that exactly the outcomes in `expected` are seen. If every schedule is explored, there is one more: the
/// thread that left the news sees that the task's thread is about to sleep, and handles the news itself, before the
/// task's thread checks the inbox. Schedules drawn at random rarely show that outcome.
fn news_end_every_wait(looks: u32, expected: &[(Waited, bool)]) {
    let seen = explore(move || ask_for_news(None, looks));
    let rare = (Waited::Awake, false);
    assert!(!SEES_OLD_VALUES || seen.contains_key(&rare), "{seen:?}");
    let outcomes: Vec<_> = seen.keys().copied().filter(|&outcome| outcome != rare).collect();
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn news_that_waited_for_a_thread_that_ran_end_its_wait() {
    let expected = [(Waited::NotAtAll, true), (Waited::Awake, true), (Waited::Asleep, false)];
    news_end_every_wait(0, &expected);
}

#[test]
fn news_that_waited_are_found_by_who_looks() {
    let expected =
        [(Waited::NotAtAll, true), (Waited::Looking, true), (Waited::Awake, true), (Waited::Asleep, false)];
    news_end_every_wait(2, &expected);
}

/// News come before the task's thread checks its inbox, and another thread may have handled them by then. Returns
/// whether the first check finds them, although no thread wakes the task's thread.
fn look_after_news(plant: Option<Plant>) -> bool {
    let handoff = toy(plant);
    let mut worked = 0;
    handoff.enter(Brought::Nothing, &mut worked);
    let other = bring(&handoff, Brought::News);
    handoff.enter(Brought::Nothing, &mut worked);
    other.join().unwrap();
    let there = handoff.has_left();
    let found = handoff.look(|| false, |there| there());
    assert_eq!(found, there, "it looked past what was left");
    found
}

#[test]
fn who_begins_to_look_sees_what_was_left_before() {
    let seen = explore(|| look_after_news(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
    must_fail("looked past", || look_after_news(Some(Plant::LooksPastIt)));
}

#[test]
fn who_sleeps_on_what_was_left_to_it_sleeps_for_ever() {
    must_fail(DEADLOCK, || ask_for_news(Some(Plant::SleepsOnIt), 0));
}

#[test]
fn who_leaves_news_and_does_not_see_that_the_thread_sleeps_by_now_leaves_them_for_ever() {
    must_fail(DEADLOCK, || ask_for_news(Some(Plant::TrustsTheRun), 0));
}

#[test]
fn without_its_fence_what_was_left_to_a_thread_that_ran_is_not_seen() {
    if SEES_OLD_VALUES {
        must_fail(DEADLOCK, || ask_for_news(Some(Plant::NoFenceForARunner), 0));
    }
}

/// An answer comes while the task's thread takes the lock; then that thread computes for long. Returns whether the
/// other thread handled the answer.
fn answer_one_that_computes(plant: Option<Plant>) -> bool {
    let handoff = toy(plant);
    let mut worked = 0;
    handoff.enter(Brought::Nothing, &mut worked);
    let other = bring(&handoff, Brought::Answer);
    handoff.enter(Brought::Nothing, &mut worked);
    let others = other.join().unwrap();
    assert_eq!(handoff.look_at(|toy| toy.fed), 3, "an answer stayed behind");
    others > 0
}

#[test]
fn what_may_not_wait_is_not_left_to_a_thread_that_computes() {
    let seen = explore(|| answer_one_that_computes(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
    must_fail("stayed behind", || answer_one_that_computes(Some(Plant::TrustsTheLook)));
}

/// Two news come for a task whose thread computes. `is_entered`: whether the task has used its communication task
/// before. At most one of the news may wait in the inbox. Returns how many wait.
fn news_for_one_that_computes(is_entered: bool) -> u32 {
    let handoff = toy(None);
    let mut worked = 0;
    if is_entered {
        handoff.enter(Brought::Nothing, &mut worked);
    }
    let before = worked;
    let others = [bring(&handoff, Brought::News), bring(&handoff, Brought::News)];
    let worked = others.map(|other| other.join().unwrap());
    let fed = handoff.look_at(|toy| toy.fed - before);
    assert_eq!(fed, worked.into_iter().sum());
    2 - fed
}

#[test]
fn few_news_wait_for_a_thread_that_computes_and_none_before_it_has_entered() {
    for is_entered in [false, true] {
        let seen = explore(move || news_for_one_that_computes(is_entered));
        assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0], "{is_entered}: {seen:?}");
    }
}

/// News come while the task's program ends. Returns whether the end of the program handled them.
fn end_with_news(ends: bool) -> bool {
    let handoff = toy(None);
    let mut worked = 0;
    handoff.enter(Brought::Poll, &mut worked);
    let other = bring(&handoff, Brought::News);
    let before = worked;
    if ends {
        handoff.end(&mut worked);
    }
    let own = worked > before;
    other.join().unwrap();
    let fed = handoff.look_at(|toy| toy.fed);
    assert_eq!(fed, 2, "news stayed behind");
    own
}

#[test]
fn nothing_is_left_to_a_program_that_has_ended() {
    let seen = explore(|| end_with_news(true));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
}

#[test]
fn what_is_left_to_a_program_that_does_not_say_that_it_ended_stays_behind() {
    must_fail("news stayed behind", || end_with_news(false));
}
