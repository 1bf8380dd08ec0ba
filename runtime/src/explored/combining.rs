//! Scenes of the combining lock: its holder does the work of the threads that found the lock taken.

use super::must_fail;
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, thread};
use crate::sync::combining_lock::{self, CombiningLock};
use crate::sync::{Mutex, lock};

/// Two threads each add some work to a pile and try to take the lock, whose holder does all work of the pile. Returns
/// the most work that one of the threads did.
fn two_take_turns(plant: Option<combining_lock::Plant>) -> u32 {
    fn put_and_take(turn: &CombiningLock<(), Option<combining_lock::Plant>>, pile: &Mutex<u32>) -> u32 {
        *lock(pile) += 1;
        turn.want();
        let mut carried = 0;
        turn.take(|()| carried += std::mem::take(&mut *lock(pile)));
        carried
    }
    let shared = Arc::new((CombiningLock::planted((), plant), Mutex::new(0)));
    let theirs = Arc::clone(&shared);
    let other = thread::spawn(move || put_and_take(&theirs.0, &theirs.1));
    let own = put_and_take(&shared.0, &shared.1);
    let others = other.join().unwrap();
    assert_eq!(own + others, 2, "something was left lying");
    own.max(others)
}

/// As [`two_take_turns`], but a thread that finds the lock free does its own work directly, and does not add it to
/// the pile.
fn two_enter(blindly: bool) -> u32 {
    fn carry_or_put(turn: &CombiningLock<()>, pile: &Mutex<u32>, blindly: bool) -> u32 {
        let mut carried = 0;
        if let Some(own) = turn.enter() {
            carried += 1 + std::mem::take(&mut *lock(pile));
            drop(own);
            if blindly {
                return carried;
            }
        } else {
            *lock(pile) += 1;
            turn.want();
        }
        turn.take(|()| carried += std::mem::take(&mut *lock(pile)));
        carried
    }
    let shared = Arc::new((CombiningLock::new(()), Mutex::new(0)));
    let theirs = Arc::clone(&shared);
    let other = thread::spawn(move || carry_or_put(&theirs.0, &theirs.1, blindly));
    let own = carry_or_put(&shared.0, &shared.1, blindly);
    let others = other.join().unwrap();
    assert_eq!(own + others, 2, "something was left lying");
    own.max(others)
}

#[test]
fn what_was_not_put_down_is_carried_with_what_was() {
    let seen = explore(|| two_enter(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn who_enters_and_does_not_look_again_leaves_something_lying() {
    must_fail("something was left lying", || two_enter(true));
}

#[test]
fn nothing_is_left_lying_by_those_who_found_another_at_work() {
    let seen = explore(|| two_take_turns(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn leaving_without_another_look_leaves_something_lying() {
    must_fail("something was left lying", || two_take_turns(Some(combining_lock::Plant::LeavesBlindly)));
}

#[test]
fn without_its_fence_the_turn_leaves_something_lying() {
    if SEES_OLD_VALUES {
        must_fail("something was left lying", || two_take_turns(Some(combining_lock::Plant::NoFence)));
    }
}
