//! Side-by-side measurements: the runtime against hand-written baselines (`floor/..`), and, with the features `peers` and
//! `network-peers`, against libraries that people would use instead.
//!
//! Cases are measured in turns, round by round, and only ratios of values from one round are judged ([`harness`]),
//! because absolute times on a shared machine vary by a factor of two. `specs/performance.md` explains the rows.
#![forbid(unsafe_code)]

pub mod cases;
mod command;
pub mod cores;
pub mod duel;
pub mod harness;
pub mod judge;
pub mod machine;
pub mod memory;
mod peers;
pub mod report;
pub mod sample;
pub mod suite;
pub mod surroundings;

pub use command::{BenchArgs, BenchError, Form, Verdict, run};
