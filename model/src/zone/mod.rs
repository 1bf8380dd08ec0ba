//! Zones: sets of times at which a step does the same.
//!
//! ```text
//!   dbm     the sets: bounds on differences of integers, closed; inclusion, projection, exact union
//!   forks   runs code on the variables of a zone, once for each sequence of answers that some of its points give
//!   times   the times of a packed state: its bytes say where there are times, its zone which ones
//! ```
//!
//! The code that runs is the machine itself: its times are symbols (`imrs_protocol::symbolic`), and a comparison whose answer
//! differs within the zone forks.

pub(crate) mod dbm;
pub(crate) mod forks;
mod pack;
pub(crate) mod times;
