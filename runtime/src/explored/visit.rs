//! Scenes of a visit: a thread uses the state behind a task's lock without bringing an input, for example
//! because an action of a script ended, or because the node starts.

use super::handoff::{Brought, Got, Toy};
use super::{DEADLOCK, must_fail_large};
use crate::explorer::{Arc, explore_large, thread};
use crate::sync::handoff::{Handoff, Plant};

/// The task makes a request and waits. One thread brings the answer, or leaves it in the inbox because another
/// thread, the visitor, has the lock. Returns whether the visitor handled the answer.
fn ask_while_visited(plant: Option<Plant>) -> bool {
    let handoff = Arc::new(Handoff::planted(Toy::default(), None, plant));
    let [theirs, visited] = [(); 2].map(|()| Arc::clone(&handoff));
    let other = thread::spawn(move || theirs.deliver(Brought::Answer, &mut 0));
    let visitor = thread::spawn(move || {
        let mut worked = 0;
        visited.visit(|_, _| (), &mut worked);
        worked > 0
    });
    let mut worked = 0;
    let mut entry = handoff.enter(Brought::Question, &mut worked);
    while entry.completion.is_none() {
        handoff.sleep(None);
        entry = handoff.enter(Brought::Nothing, &mut worked);
    }
    assert_eq!(entry.completion, Some(Got::Answer));
    other.join().unwrap();
    visitor.join().unwrap()
}

#[test]
fn an_answer_that_a_visitor_finds_ends_the_wait() {
    let seen = explore_large(|| ask_while_visited(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [false, true], "{seen:?}");
}

#[test]
fn a_visitor_that_does_not_mark_the_word_loses_the_wake_up() {
    must_fail_large(DEADLOCK, || ask_while_visited(Some(Plant::NoMark)));
}
