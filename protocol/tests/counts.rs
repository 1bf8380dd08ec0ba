//! Tests that count allocations. The counting allocator serves a whole program, so these tests have a program of their own.

mod alloc;
mod allocations;
mod script_alloc;

use allocations::allocations;
