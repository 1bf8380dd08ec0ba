//! Scenes of a bundle: several inputs that a thread brings at once, under one lock or in several slots of the inbox.

use super::handoff::{Brought, Got, Waited, ask, toy};
use super::{DEADLOCK, must_fail, must_fail_large};
use crate::clock::FAR;
use crate::explorer::{Arc, explore, explore_large, thread};
use crate::sync::handoff::{Handoff, Plant, Protected, Rest};
use std::collections::VecDeque;
use std::sync::atomic::Ordering;

/// The inputs that arrived, in order.
#[derive(Default)]
struct Came(Vec<u8>);

impl Protected for Came {
    type Input = u8;
    type Completion = ();
    /// How many inputs this thread has handled.
    type Effects = u32;

    fn may_wait(_: &u8) -> bool {
        false
    }

    fn feed(&mut self, input: &mut u8, worked: &mut u32) -> Option<()> {
        self.0.push(*input);
        *worked += 1;
        None
    }

    fn settle(&mut self, _rest: Rest, _worked: &mut u32) -> u64 {
        FAR
    }
}

/// A thread brings a bundle of the inputs 1 to `last`, while another thread brings input 4. The inbox has room for
/// two. All inputs arrive, and those of the bundle in order. Returns whether the inbox was full, and how many inputs
/// the first thread handled.
fn bring_a_bundle(plant: Option<Plant>, last: u8) -> (bool, u32) {
    let handoff = Arc::new(Handoff::planted(Came::default(), None, plant));
    let theirs = Arc::clone(&handoff);
    let other = thread::spawn(move || theirs.deliver(4, &mut 0));
    let (mut bundle, mut worked) = ((1..=last).collect(), 0);
    handoff.deliver_all(&mut bundle, &mut worked);
    assert!(bundle.is_empty(), "some of the bundle was not brought");
    other.join().unwrap();
    let came = handoff.look_at(|came| came.0.clone());
    assert_eq!(came.len(), usize::from(last) + 1, "input stayed behind");
    let of_bundle: Vec<u8> = came.into_iter().filter(|&input| input != 4).collect();
    assert!(of_bundle.is_sorted(), "the order was lost: {of_bundle:?}");
    (handoff.inbox.room.1.load(Ordering::Relaxed), worked)
}

#[test]
fn a_bundle_comes_whole_and_in_order() {
    let seen = explore(|| bring_a_bundle(None, 2));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [(false, 0), (false, 1), (false, 2), (false, 3)], "{seen:?}");
}

#[test]
fn a_bundle_that_fills_the_inbox_comes_whole_and_in_order() {
    let seen = explore_large(|| bring_a_bundle(None, 3));
    let full: Vec<_> = seen.keys().filter(|(is_full, _)| *is_full).collect();
    assert!(!full.is_empty() && full.len() < seen.len(), "{seen:?}");
}

#[test]
fn a_bundle_that_was_left_when_the_lock_was_released_stays_behind() {
    must_fail("input stayed behind", || bring_a_bundle(Some(Plant::LeavesItsBundle), 2));
}

#[test]
fn what_a_full_inbox_drops_of_a_bundle_is_missed() {
    must_fail_large("input stayed behind", || bring_a_bundle(Some(Plant::DropsWhenFull), 3));
}

#[test]
fn the_rest_of_a_bundle_does_not_overtake_what_was_left_of_it() {
    must_fail_large("the order was lost", || bring_a_bundle(Some(Plant::Overtakes), 3));
}

/// A task makes a request, checks for the answer once and sleeps; another thread brings a bundle with the answer.
/// Returns how the task waited, and whether its own thread handled the answer.
fn wait_for_a_bundle(plant: Option<Plant>) -> (Waited, bool) {
    let handoff = toy(plant);
    let theirs = Arc::clone(&handoff);
    let other = thread::spawn(move || {
        let mut worked = 0;
        theirs.deliver_all(&mut VecDeque::from([Brought::Nothing, Brought::Answer]), &mut worked);
        worked
    });
    let (waited, got) = ask(&handoff, || handoff.look(|| false, |there| there()));
    assert_eq!(got, Got::Answer);
    (waited, other.join().unwrap() == 0)
}

#[test]
fn a_bundle_ends_the_wait_of_a_thread_that_spins_or_sleeps() {
    let seen = explore_large(|| wait_for_a_bundle(None));
    for outcome in [(Waited::NotAtAll, false), (Waited::Looking, true), (Waited::Asleep, false)] {
        assert!(seen.contains_key(&outcome), "{outcome:?}: {seen:?}");
    }
}

#[test]
fn a_bundle_left_to_a_thread_that_spins_no_more_is_left_for_ever() {
    must_fail_large(DEADLOCK, || wait_for_a_bundle(Some(Plant::TrustsTheLook)));
}
