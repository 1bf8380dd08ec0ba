//! Scenes of the lane that carries records from a task's steps to the recording thread: a published record is whole, and a
//! slot that was given back is not read any more.

use super::must_fail;
use crate::explorer::{SEES_OLD_VALUES, explore, thread};
use crate::sync::lane::{Drain, Plant, used_lane};

/// Takes the published records. Each record has two slots, which hold the same number.
fn take(drain: &mut Drain<1, Option<Plant>>, taken: &mut Vec<u64>) {
    let until = drain.filled();
    while let Some([number]) = drain.next(until) {
        assert_eq!(drain.next(until), Some([number]), "not what was put in");
        taken.push(number);
        drain.give_back();
    }
}

/// Yields to other threads if schedules are drawn at random: no thread waits in these scenes, so the explorer needs a
/// hint where to switch threads. If all schedules are explored, this does nothing, because loom would not run this
/// thread again before another thread has run.
fn let_others_run() {
    if !SEES_OLD_VALUES {
        thread::yield_now();
    }
}

/// One thread puts two records into a lane with room for one, while another thread takes records. `before` is how
/// many slots the lane has already counted. Returns how many records found room, and whether one was taken before
/// both had been put.
fn two_records(before: usize, plant: Option<Plant>) -> (u64, bool) {
    let (mut fill, mut drain) = used_lane::<1, _>(2, before, plant);
    let other = thread::spawn(move || {
        let mut found_room = 0;
        for _ in 0..2 {
            let_others_run();
            if fill.has_room(2, || ()) {
                found_room += 1;
                (0..2).for_each(|_| fill.put([found_room]));
                fill.publish();
            }
        }
        found_room
    });
    let mut taken = Vec::new();
    for _ in 0..2 {
        take(&mut drain, &mut taken);
        let_others_run();
    }
    let meanwhile = !taken.is_empty();
    let found_room = other.join().unwrap();
    take(&mut drain, &mut taken);
    assert!(taken.iter().copied().eq(1..=found_room), "not what was put in: {taken:?} of {found_room}");
    (found_room, meanwhile)
}

#[test]
fn what_found_room_comes_out_whole_and_in_order() {
    // These values of `before` let the slot counters overflow between the two records, or within the second.
    for before in [0, usize::MAX - 1, usize::MAX - 2] {
        let seen = explore(move || two_records(before, None));
        let outcomes: Vec<_> = seen.keys().copied().collect();
        assert_eq!(outcomes, [(1, false), (1, true), (2, true)], "{before}: {seen:?}");
    }
}

#[test]
fn what_is_shown_before_it_is_there_is_torn() {
    must_fail("not what was put in", || two_records(0, Some(Plant::ShownFirst)));
}

#[test]
fn what_is_given_back_before_it_was_read_is_torn() {
    must_fail("not what was put in", || two_records(0, Some(Plant::GivenBackFirst)));
}

#[test]
fn what_is_shown_without_order_is_torn() {
    if SEES_OLD_VALUES {
        must_fail("not what was put in", || two_records(0, Some(Plant::NoRelease)));
    }
}
