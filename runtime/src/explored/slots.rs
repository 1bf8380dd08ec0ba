//! Scenes of the slots of an inbox: inputs that go around in a ring, and threads that leave input at the same time.

use super::{Listed, must_fail};
use crate::explorer::{Arc, explore, thread};
use crate::sync::inbox::{Inbox, Plant};

impl Listed for u8 {
    const ALL: &[Self] = &[0, 1, 2, 3, 4];
}

/// A thread leaves the inputs 1 to 4 in an inbox until the inbox is full, while another thread takes inputs. Every
/// input that was left is taken, in the same order. Returns how many were left.
fn go_around(plant: Option<Plant>) -> usize {
    let (inbox, mut taker) = Inbox::<u8, _>::planted(plant);
    let inbox = Arc::new(inbox);
    let theirs = Arc::clone(&inbox);
    let other = thread::spawn(move || (1..=4).filter(|&input| theirs.leave(input).is_ok()).collect());
    let mut taken: Vec<u8> = (0..3).filter_map(|_| inbox.take(&mut taker)).collect();
    let left: Vec<u8> = other.join().unwrap();
    taken.extend(std::iter::from_fn(|| inbox.take(&mut taker)));
    assert_eq!(taken, left, "other inputs were taken");
    assert!(inbox.is_empty());
    left.len()
}

#[test]
fn what_goes_around_is_taken_in_order_and_once() {
    let seen = explore(|| go_around(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [2, 3, 4], "{seen:?}");
}

#[test]
fn a_number_that_is_there_before_its_words_shows_others() {
    must_fail("other inputs were taken", || go_around(Some(Plant::NumberFirst)));
}

#[test]
fn a_slot_that_is_given_back_unread_is_overwritten() {
    must_fail("other inputs were taken", || go_around(Some(Plant::TakenFirst)));
}

#[test]
fn what_is_left_without_room_overwrites_what_waits() {
    must_fail("other inputs were taken", || go_around(Some(Plant::Overfull)));
}

/// Two threads leave an input each, and then one of them takes. Returns the first input that it takes.
fn two_leave(plant: Option<Plant>) -> u8 {
    let (inbox, mut taker) = Inbox::<u8, _>::planted(plant);
    let inbox = Arc::new(inbox);
    let theirs = Arc::clone(&inbox);
    let other = thread::spawn(move || theirs.leave(1).is_ok());
    assert!(inbox.leave(2).is_ok());
    let first = inbox.take(&mut taker).expect("an input is there and is not found");
    assert!(other.join().unwrap());
    let second = inbox.take(&mut taker);
    assert_eq!(second, Some(3 - first), "the other one is gone");
    first
}

#[test]
fn an_input_hides_no_other() {
    let seen = explore(|| two_leave(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [1, 2], "{seen:?}");
}

#[test]
fn an_input_that_comes_out_of_turn_hides_others() {
    must_fail("is not found", || two_leave(Some(Plant::OutOfTurn)));
}
