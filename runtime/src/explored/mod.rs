//! Explores the concurrent parts of the runtime, each in small scenes of two or three threads. An explorer (loom or
//! shuttle) runs a scene under many schedules (orders of the threads' steps). In the unit tests, loom takes all
//! schedules with a bounded number of preemptions, stale values of atomics included. In `tests/schedules`, shuttle
//! draws many more schedules. Both compile these same files; `crate::explorer` is the explorer in use. A large scene
//! has a smaller bound by default, which shows the same outcomes and finds the same bugs (`explore_large`).
//!
//! A scene returns its outcome. Each test asserts the whole set of outcomes. Beside it stand tests in which a bug is
//! planted on purpose, and must be found. An exploration that sees only one outcome, or misses the bug, proves nothing.

mod bundles;
mod combining;
mod domain;
mod futures;
mod handoff;
mod inbox;
mod lane;
mod lead;
mod looks;
mod news;
mod park;
mod ready;
mod slots;
mod time;
mod visit;

use crate::explorer::{AtomicU64, explore, explore_large};
use crate::sync::inbox::Slotted;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The explorer's message when every thread sleeps.
const DEADLOCK: &str = "deadlock";

/// An input of a scene. The inbox stores an input as its position in `ALL`.
trait Listed: Copy + PartialEq + 'static {
    const ALL: &'static [Self];
}

impl<I: Listed> Slotted for I {
    type Words = [u64; 1];
    type Atomics = [AtomicU64; 1];

    fn atomics() -> [AtomicU64; 1] {
        [AtomicU64::new(0)]
    }

    fn to_words(&self) -> Option<[u64; 1]> {
        let position = Self::ALL.iter().position(|input| input == self)?;
        Some([position as u64])
    }

    fn of_words(&[word]: &[u64; 1]) -> Self {
        Self::ALL[word as usize]
    }
}

/// Expects that the exploration finds a planted bug, which it recognises by the symptom.
fn must_fail<O: Ord + Send + 'static>(symptom: &str, body: impl Fn() -> O + Send + Sync + 'static) {
    must_be_found(symptom, || explore(body));
}

/// As [`must_fail`], for a large scene: its exploration has a smaller bound.
fn must_fail_large<O: Ord + Send + 'static>(symptom: &str, body: impl Fn() -> O + Send + Sync + 'static) {
    must_be_found(symptom, || explore_large(body));
}

fn must_be_found<T>(symptom: &str, exploration: impl FnOnce() -> T) {
    let Err(panic) = catch_unwind(AssertUnwindSafe(exploration)) else {
        panic!("the planted bug was not found");
    };
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string)).unwrap_or_default();
    assert!(text.contains(symptom), "another failure than the planted one: {text}");
}
