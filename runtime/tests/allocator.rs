//! The system's allocator, with counters.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicI64, AtomicU64, Ordering};

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How many bytes are allocated now.
static LIVE: AtomicI64 = AtomicI64::new(0);

thread_local! {
    /// How often the calling thread has allocated.
    static OWN: Cell<u64> = const { Cell::new(0) };
}

/// Whether the allocations of the threads in [`THREADS`] are counted now.
static COUNTING: AtomicBool = AtomicBool::new(false);
/// The threads that have allocated since counting began.
static THREADS: [Thread; 64] = [const { Thread { id: AtomicI32::new(0), times: AtomicU64::new(0) } }; 64];

struct Thread {
    /// The kernel's id of the thread; zero if no thread has this slot.
    id: AtomicI32,
    times: AtomicU64,
}

impl Thread {
    /// Whether this slot belongs to the thread `id`. If the slot is free, the thread gets it.
    fn is_of(&self, id: i32) -> bool {
        match self.id.compare_exchange(0, id, Ordering::Relaxed, Ordering::Relaxed) {
            Ok(_) => true,
            Err(other) => other == id,
        }
    }
}

fn count(grown: i64) {
    LIVE.fetch_add(grown, Ordering::Relaxed);
    if grown <= 0 {
        return;
    }
    OWN.set(OWN.get() + 1);
    if COUNTING.load(Ordering::Relaxed) {
        let id = rustix::thread::gettid().as_raw_nonzero().get();
        if let Some(thread) = THREADS.iter().find(|thread| thread.is_of(id)) {
            thread.times.fetch_add(1, Ordering::Relaxed);
        }
    }
}

// SAFETY: every call goes to the system's allocator unchanged; the counting touches only numbers, which need no allocation and no
// destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: the caller's promise is passed on unchanged.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as i64));
        // SAFETY: the caller's promise is passed on unchanged; `alloc` took the memory from the same allocator.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size as i64 - layout.size() as i64);
        // SAFETY: the caller's promise is passed on unchanged; `alloc` took the memory from the same allocator.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

/// How many allocated bytes the process holds now.
pub fn live() -> i64 {
    LIVE.load(Ordering::Relaxed)
}

/// How often the calling thread has allocated so far.
pub fn of_this_thread() -> u64 {
    OWN.get()
}

/// Counts for each thread how often it allocates.
pub struct ByThread(());

impl ByThread {
    pub fn begin() -> Self {
        for Thread { id, times } in &THREADS {
            times.store(0, Ordering::Relaxed);
            id.store(0, Ordering::Relaxed);
        }
        COUNTING.store(true, Ordering::SeqCst);
        Self(())
    }

    /// The threads with these names that allocated, and how often each did. The threads must still run, because only then
    /// they have a name.
    pub fn end(self, names: &[&str]) -> Vec<(String, u64)> {
        COUNTING.store(false, Ordering::SeqCst);
        assert_eq!(THREADS[THREADS.len() - 1].id.load(Ordering::Relaxed), 0, "too many threads to count");
        let named = |thread: &Thread| {
            let id = thread.id.load(Ordering::Relaxed);
            let name = std::fs::read_to_string(format!("/proc/self/task/{id}/comm")).ok()?;
            let is_wanted = names.contains(&name.trim_end());
            is_wanted.then(|| (name.trim_end().to_owned(), thread.times.load(Ordering::Relaxed)))
        };
        THREADS.iter().filter_map(named).collect()
    }
}
