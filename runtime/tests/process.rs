//! The tests that count what the whole process does, or stop it: allocations, memory, sleeps of threads, a crash. They run
//! one at a time: each test first takes the turn ([`alone`]).

mod allocation;
mod allocator;
mod awake;
#[allow(dead_code, reason = "`all.rs` uses the rest")]
mod common;
mod failstop;
mod idle;
mod leader;
mod soak;
mod timers;
mod udp_allocation;
mod watching_cost;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Takes the turn of a test. The test holds it until its end, so that nothing of another test is counted.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    // A test that failed has given up its turn.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}
