//! Scenes of futures that are marked as ready: two of them, woken by two threads, are polled by a third.

use super::{DEADLOCK, must_fail};
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, thread};
use crate::sync::park::Park;
use crate::sync::ready::{Plant, ReadyFutures};
use crate::sync::{AtomicBool, Ordering};

struct Scene {
    ready: ReadyFutures<Option<Plant>>,
    /// A flag for each future, which ends once it finds its flag set. The flags are accessed with relaxed ordering,
    /// so that only the wake-up orders these accesses.
    came: [AtomicBool; 2],
}

impl Scene {
    fn new(plant: Option<Plant>) -> Arc<Self> {
        let ready = ReadyFutures::planted(2, Park::new(None), plant);
        Arc::new(Self { ready, came: [AtomicBool::new(false), AtomicBool::new(false)] })
    }

    fn bring(self: &Arc<Self>, place: usize) -> thread::JoinHandle<()> {
        let scene = Arc::clone(self);
        thread::spawn(move || {
            scene.came[place].store(true, Ordering::Relaxed);
            scene.ready.wake(place);
        })
    }

    /// Runs the thread of the futures until the futures in `waits` have ended. Returns how often each of them was
    /// polled before it ended.
    fn run(&self, waits: [bool; 2]) -> [u32; 2] {
        self.run_and(waits, |_| (), || false)
    }

    /// As [`run`](Self::run). Also calls `ended` with each future that ends. Does not sleep while `any` returns true.
    fn run_and(&self, mut waits: [bool; 2], ended: impl Fn(usize), any: impl Fn() -> bool) -> [u32; 2] {
        let mut polls = [0; 2];
        loop {
            self.ready.poll_ready(|place| {
                polls[place] += u32::from(waits[place]);
                if waits[place] && self.came[place].load(Ordering::Relaxed) {
                    waits[place] = false;
                    ended(place);
                }
            });
            if waits == [false; 2] {
                return polls;
            }
            // This check only avoids a sleep for marks that other threads set. It is not needed for correctness:
            // these threads also wake the thread of the futures.
            if !any() {
                self.ready.park.sleep();
            }
        }
    }
}

/// Two threads each wake a future of their own.
fn each_wakes_one(plant: Option<Plant>) -> [u32; 2] {
    let scene = Scene::new(plant);
    let others = [scene.bring(0), scene.bring(1)];
    let polls = scene.run([true; 2]);
    others.into_iter().for_each(|other| other.join().unwrap());
    polls
}

/// Two threads wake the same future. The thread that finds the future already marked does not wake the futures' thread.
fn both_wake_one(plant: Option<Plant>) -> [u32; 2] {
    let scene = Scene::new(plant);
    let first = scene.bring(0);
    let other = Arc::clone(&scene);
    let second = thread::spawn(move || other.ready.wake(0));
    let polls = scene.run([true, false]);
    first.join().unwrap();
    second.join().unwrap();
    polls
}

/// A thread wakes the second future, and the second future wakes the first.
fn one_wakes_the_other(asks: bool) -> [u32; 2] {
    let scene = Scene::new(None);
    let other = scene.bring(1);
    let ended = |place| {
        if place == 1 {
            scene.came[0].store(true, Ordering::Relaxed);
            scene.ready.mark_own(0);
        }
    };
    let polls = scene.run_and([true; 2], ended, || asks && scene.ready.any());
    other.join().unwrap();
    polls
}

#[test]
fn a_future_that_another_one_wakes_is_polled_again() {
    let seen = explore(|| one_wakes_the_other(true));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [[2, 1], [2, 2]], "{seen:?}");
}

#[test]
fn a_thread_that_sleeps_on_its_own_mark_sleeps_for_ever() {
    must_fail(DEADLOCK, || one_wakes_the_other(false));
}

#[test]
fn each_future_that_was_woken_is_polled_again() {
    let seen = explore(|| each_wakes_one(None));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [[1, 1], [1, 2], [2, 1], [2, 2]], "{seen:?}");
}

#[test]
fn a_future_that_two_threads_wake_is_polled_again() {
    let seen = explore(|| both_wake_one(None));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [[1, 0], [2, 0], [3, 0]], "{seen:?}");
}

#[test]
fn a_mark_that_is_made_late_or_cleared_unseen_is_a_future_that_waits_for_ever() {
    for plant in [Plant::CallsFirst, Plant::TakesInTwoSteps, Plant::BeginsLate] {
        must_fail(DEADLOCK, move || each_wakes_one(Some(plant)));
    }
}

#[test]
fn a_waker_that_only_reads_the_mark_hands_on_nothing() {
    if SEES_OLD_VALUES {
        must_fail(DEADLOCK, || both_wake_one(Some(Plant::OnlyReads)));
    }
}
