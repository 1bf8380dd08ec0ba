//! What replaces the allocator, to count: it serves the whole test program, so these tests have one of their own.

mod alloc;
mod allocations;
mod script_alloc;

use allocations::allocations;
