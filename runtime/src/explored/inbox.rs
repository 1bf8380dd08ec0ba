//! Scenes of the inbox in which threads leave input for the thread that runs a communication task: several threads bring
//! input at once, fill the inbox, or leave input in it.

use super::handoff::{Brought, Got, Toy, bring, toy};
use super::{DEADLOCK, must_fail, must_fail_large};
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, explore_large, thread};
use crate::sync::handoff::{Entry, Handoff, Plant};

/// A thread brings two answers. The task waits for one and then takes every answer that has come, until it has both.
/// Returns the most answers that it took at once.
fn take_several(plant: Option<Plant>) -> u32 {
    let handoff = toy(plant);
    let bringing = Arc::clone(&handoff);
    let other = thread::spawn(move || (0..2).for_each(|_| bringing.deliver(Brought::Answer, &mut 0)));
    let (mut taken, mut most, mut worked) = (0, 0, 0);
    while taken < 2 {
        let (mut at_once, mut input) = (0, Brought::Question);
        while at_once == 0 {
            let more = |_: &Got| {
                at_once += 1;
                Some(Brought::Poll)
            };
            handoff.enter_and(input, more, &mut worked);
            if at_once == 0 {
                handoff.sleep(None);
                input = Brought::Nothing;
            }
        }
        (taken, most) = (taken + at_once, most.max(at_once));
    }
    other.join().unwrap();
    assert_eq!((taken, handoff.look_at(|toy| toy.kept)), (2, 0), "an answer was taken twice");
    most
}

#[test]
fn several_are_taken_under_one_lock_and_none_is_lost() {
    let seen = explore_large(|| take_several(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn taking_several_without_a_second_look_waits_for_what_was_left() {
    must_fail_large(DEADLOCK, || take_several(Some(Plant::NoSecondLook)));
}

/// The task's thread makes a request and spins, while another thread brings two answers. Once the task has
/// one answer, its thread does not take the lock again. Returns how many answers the other thread handled.
fn two_come_to_one_that_looks(plant: Option<Plant>) -> u32 {
    let handoff = toy(plant);
    let mut worked = 0;
    handoff.enter(Brought::Question, &mut worked);
    let bringing = Arc::clone(&handoff);
    let other = thread::spawn(move || {
        let mut worked = 0;
        (0..2).for_each(|_| bringing.deliver(Brought::Answer, &mut worked));
        worked
    });
    let mut entry = Entry { completion: None, stopped: false, until: 0 };
    while entry.completion.is_none() {
        if !handoff.look(|| false, |there| there()) {
            handoff.sleep(None);
        }
        entry = handoff.come_back_and(Brought::Nothing, |_| None, &mut worked);
    }
    let others = other.join().unwrap();
    assert!(handoff.look_at(|toy| toy.kept) == 1, "input stayed behind");
    others
}

#[test]
fn what_comes_when_a_look_has_ended_is_not_left_behind() {
    let seen = explore(|| two_come_to_one_that_looks(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1, 2], "{seen:?}");
}

#[test]
fn without_a_second_look_what_comes_when_a_look_has_ended_stays_behind() {
    must_fail("input stayed behind", || two_come_to_one_that_looks(Some(Plant::NoSecondLook)));
    if SEES_OLD_VALUES {
        must_fail("input stayed behind", || two_come_to_one_that_looks(Some(Plant::NoFence)));
    }
}

/// Two threads bring an input each at the same time. Returns the greater of the numbers of inputs that each handled.
fn two_bring(plant: Option<Plant>) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut own = 0;
    handoff.deliver(Brought::Answer, &mut own);
    let others = other.join().unwrap();
    assert_eq!(handoff.look_at(|toy| toy.fed), 2, "input stayed behind");
    own.max(others)
}

#[test]
fn whoever_holds_the_lock_works_for_all() {
    let seen = explore(|| two_bring(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn without_a_second_look_input_stays_behind() {
    must_fail("input stayed behind", || two_bring(Some(Plant::NoSecondLook)));
}

#[test]
fn without_its_fence_the_second_look_is_in_vain() {
    if SEES_OLD_VALUES {
        must_fail("input stayed behind", || two_bring(Some(Plant::NoFence)));
    }
}

/// Three threads bring an input each at the same time, and the inbox has room for one. Returns whether a thread found
/// it full.
fn three_bring(plant: Option<Plant>) -> bool {
    let mut handoff = Handoff::planted(Toy::default(), None, plant);
    handoff.inbox.room.0 = 1;
    let handoff = Arc::new(handoff);
    let others = [bring(&handoff, Brought::Answer), bring(&handoff, Brought::Answer)];
    let mut own = 0;
    handoff.deliver(Brought::Answer, &mut own);
    for other in others {
        other.join().unwrap();
    }
    assert_eq!(handoff.look_at(|toy| toy.fed), 3, "input stayed behind");
    handoff.inbox.room.1.load(std::sync::atomic::Ordering::Relaxed)
}

#[test]
fn whoever_finds_the_inbox_full_waits_for_the_lock() {
    let seen = explore_large(|| three_bring(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
}

#[test]
fn input_that_a_full_inbox_drops_is_missed() {
    must_fail_large("input stayed behind", || three_bring(Some(Plant::DropsWhenFull)));
}

/// One thread reads the protected state while another brings input. Returns how many inputs the reading thread
/// handled.
fn one_looks(plant: Option<Plant>) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut worked = 0;
    handoff.with(|_| (), &mut worked);
    assert_eq!(worked + other.join().unwrap(), 1, "input stayed behind");
    worked
}

#[test]
fn whoever_only_looks_still_works_off_what_was_left() {
    let seen = explore(|| one_looks(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1], "{seen:?}");
}

#[test]
fn looking_without_a_second_look_leaves_input_behind() {
    must_fail("input stayed behind", || one_looks(Some(Plant::NoSecondLook)));
}

/// One thread leaves input and wakes the task, while another thread brings input. Returns how many inputs the first thread
/// handled.
fn one_leaves(plant: Option<Plant>) -> u32 {
    let handoff = toy(plant);
    let other = bring(&handoff, Brought::Answer);
    let mut worked = 0;
    assert!(handoff.leave(Brought::Answer).is_ok(), "the inbox has room");
    handoff.wake(&mut worked);
    assert_eq!(worked + other.join().unwrap(), 2, "input stayed behind");
    worked
}

#[test]
fn what_was_left_is_worked_off() {
    let seen = explore(|| one_leaves(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1, 2], "{seen:?}");
}

#[test]
fn a_wake_up_without_a_look_leaves_input_behind() {
    must_fail("input stayed behind", || one_leaves(Some(Plant::NoSecondLook)));
}
