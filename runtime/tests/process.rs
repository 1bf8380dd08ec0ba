//! The tests that count what the whole process does, or stop it: allocations, memory, sleeps of threads, a crash. They
//! run one at a time: each test first takes a lock ([`alone`]).

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

/// Takes the lock of these tests. A test holds it until its end, so that it counts nothing of another test.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    // The lock of a failed test is poisoned, and free.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}
