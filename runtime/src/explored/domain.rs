//! Scenes of a domain, here two tasks that share one lock. An input that one of the two tasks sends to the
//! other waits with the working thread. That thread takes it while it still holds the lock (in the same
//! turn), or in its next turn.

use super::must_fail_large;
use crate::clock::FAR;
use crate::explorer::{Arc, explore_large, thread};
use crate::sync::handoff::{Handoff, Plant, Protected, Rest};
use std::collections::VecDeque;

/// Two members of a domain. For each of its inputs, the first member sends an input to the second.
#[derive(Default)]
struct Two {
    /// The inputs that the second member got, in order.
    got: Vec<u8>,
}

/// The inputs that a thread still has to give the second member, and how often it took the lock again for this.
#[derive(Default)]
struct Carried {
    inside: VecDeque<u8>,
    turns: u32,
}

impl Protected for Two {
    type Input = u8;
    type Completion = ();
    type Effects = Carried;

    fn may_wait(_: &u8) -> bool {
        false
    }

    fn feed(&mut self, input: &mut u8, carried: &mut Carried) -> Option<()> {
        carried.inside.extend([*input, *input + 1]);
        None
    }

    /// Each turn (hold of the lock) takes one input.
    fn work_inside(&mut self, carried: &mut Carried) {
        self.got.extend(carried.inside.pop_front());
    }

    fn settle(&mut self, _rest: Rest, _carried: &mut Carried) -> u64 {
        FAR
    }
}

/// A thread brings an input to the first member. The thread then takes the lock again as long as there are inputs for
/// the second member. If `goes_on` is false, a bug is planted: the thread takes the lock only once.
fn bring(handoff: &Handoff<Two, Option<Plant>>, input: u8, goes_on: bool) -> u32 {
    let mut carried = Carried::default();
    handoff.deliver(input, &mut carried);
    while goes_on && !carried.inside.is_empty() {
        carried.turns += 1;
        handoff.visit(|_, _| (), &mut carried);
    }
    carried.turns
}

/// Two threads bring an input each. The second member gets everything that the first one sends; parts of one input
/// arrive in order. Returns how often each thread took the lock again.
fn two_members(plant: Option<Plant>, goes_on: bool) -> [u32; 2] {
    let handoff = Arc::new(Handoff::planted(Two::default(), None, plant));
    let theirs = Arc::clone(&handoff);
    let other = thread::spawn(move || bring(&theirs, 1, goes_on));
    let own = bring(&handoff, 3, goes_on);
    let turns = [own, other.join().unwrap()];
    let mut got = handoff.look_at(|two| two.got.clone());
    for [first, second] in [[1, 2], [3, 4]] {
        let at = |sent: u8| got.iter().position(|&input| input == sent);
        assert!(at(second).is_some(), "what a member sent stayed behind: {got:?}");
        assert!(at(first) < at(second), "the order was lost: {got:?}");
    }
    got.sort_unstable();
    assert_eq!(got, [1, 2, 3, 4]);
    turns
}

#[test]
fn what_a_member_sends_is_taken_in_this_turn_or_the_next() {
    let seen = explore_large(|| two_members(None, true));
    for turns in [[1, 1], [0, 3], [3, 0]] {
        assert!(seen.contains_key(&turns), "{turns:?}: {seen:?}");
    }
}

#[test]
fn without_its_next_turn_what_a_member_sent_stays_behind() {
    must_fail_large("stayed behind", || two_members(None, false));
}

#[test]
fn input_for_a_member_that_was_left_during_a_turn_is_taken_when_it_ends() {
    must_fail_large("stayed behind", || two_members(Some(Plant::NoSecondLook), true));
}
