//! Task scripts (D45): every operation, every way a statement can end, interruption and nesting, fences and take-overs,
//! packed states, random programs, and scripts on whole nodes.

mod arm;
pub mod bytes;
mod check;
mod drivers;
mod fake;
mod handlers;
mod host;
mod leases;
mod ops;
mod packs;
mod random;
mod runaway;
mod shortcuts;
mod waits;
mod written;
