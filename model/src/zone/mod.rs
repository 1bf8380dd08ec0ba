//! Zones: sets of times at which a step of the state machine behaves in the same way.
//!
//! ```text
//!   dbm     the sets: bounds on differences of integers, closed; inclusion, projection, exact union
//!   forks   runs code on the variables of a zone, once for each sequence of answers that some of its points give
//!   times   the times of a packed state: its bytes say where there are times, its zone which ones
//! ```
//!
//! The code that runs is the state machine itself. Its times are symbols: differences of variables
//! (`imrs_protocol::symbolic`). If a comparison has different answers within the zone, the run forks.

pub(crate) mod dbm;
pub(crate) mod forks;
mod pack;
pub(crate) mod times;
