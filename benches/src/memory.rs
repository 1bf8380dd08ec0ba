//! What is allocated, where the program counts it.
//!
//! A program that wants the rows about memory makes its global allocator tell [`allocated`] and [`freed`]; where none
//! does, these rows are not measured. Nothing is counted while times are taken: peers that allocate would pay for it.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

static COUNTING: AtomicBool = AtomicBool::new(false);
static CALLS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicI64 = AtomicI64::new(0);

/// What was allocated while something ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocated {
    /// How often.
    pub calls: u64,
    /// Bytes still in use at its end, less what was freed meanwhile.
    pub bytes: i64,
}

/// So many bytes were allocated.
pub fn allocated(bytes: usize) {
    if COUNTING.load(Ordering::Relaxed) {
        CALLS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(i64::try_from(bytes).unwrap_or(i64::MAX), Ordering::Relaxed);
    }
}

/// So many bytes were freed.
pub fn freed(bytes: usize) {
    if COUNTING.load(Ordering::Relaxed) {
        BYTES.fetch_sub(i64::try_from(bytes).unwrap_or(i64::MAX), Ordering::Relaxed);
    }
}

/// What the whole process allocates while `work` runs; `None` where nobody counts.
pub fn counted<T>(work: impl FnOnce() -> T) -> (T, Option<Allocated>) {
    let before = (CALLS.load(Ordering::SeqCst), BYTES.load(Ordering::SeqCst));
    COUNTING.store(true, Ordering::SeqCst);
    // Shows whether the allocator tells.
    drop(std::hint::black_box(Box::new(0_u64)));
    let seen = CALLS.load(Ordering::SeqCst) - before.0;
    let done = work();
    COUNTING.store(false, Ordering::SeqCst);
    let calls = CALLS.load(Ordering::SeqCst) - before.0 - seen;
    let bytes = BYTES.load(Ordering::SeqCst) - before.1;
    (done, (seen > 0).then_some(Allocated { calls, bytes }))
}
