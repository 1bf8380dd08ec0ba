//! Counts allocations, if the program's allocator reports them.
//!
//! A program that measures memory needs a global allocator that calls [`allocated`] and [`freed`]; otherwise the rows
//! about memory are not measured. While times are measured, allocations are not counted, because the counting would
//! slow down libraries that allocate.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

static COUNTING: AtomicBool = AtomicBool::new(false);
static CALLS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicI64 = AtomicI64::new(0);

/// The allocations while some work was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocated {
    /// The number of allocations.
    pub calls: u64,
    /// The bytes that were allocated and not freed again.
    pub bytes: i64,
}

/// Reports an allocation of `bytes` bytes.
pub fn allocated(bytes: usize) {
    if COUNTING.load(Ordering::Relaxed) {
        CALLS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(i64::try_from(bytes).unwrap_or(i64::MAX), Ordering::Relaxed);
    }
}

/// Reports that `bytes` bytes were freed.
pub fn freed(bytes: usize) {
    if COUNTING.load(Ordering::Relaxed) {
        BYTES.fetch_sub(i64::try_from(bytes).unwrap_or(i64::MAX), Ordering::Relaxed);
    }
}

/// The allocations of the whole process while `work` runs; `None` if the allocator does not report them.
pub fn counted<T>(work: impl FnOnce() -> T) -> (T, Option<Allocated>) {
    let before = (CALLS.load(Ordering::SeqCst), BYTES.load(Ordering::SeqCst));
    COUNTING.store(true, Ordering::SeqCst);
    // This allocation shows whether the program's allocator calls `allocated`.
    drop(std::hint::black_box(Box::new(0_u64)));
    let seen = CALLS.load(Ordering::SeqCst) - before.0;
    let done = work();
    COUNTING.store(false, Ordering::SeqCst);
    let calls = CALLS.load(Ordering::SeqCst) - before.0 - seen;
    let bytes = BYTES.load(Ordering::SeqCst) - before.1;
    (done, (seen > 0).then_some(Allocated { calls, bytes }))
}
