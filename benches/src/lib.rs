//! Side-by-side measurements: the runtime against floors written by hand, and, with the features `peers` and `network-peers`,
//! against what people would pick instead.
//!
//! Cases are measured in turns, round by round, and only ratios of one round are judged ([`harness`]), because absolute
//! times of a shared machine move by a factor of two. `specs/performance.md` says how to read the rows.
#![forbid(unsafe_code)]

pub mod cases;
mod command;
pub mod cores;
pub mod harness;
pub mod machine;
pub mod memory;
mod peers;
pub mod report;
pub mod sample;
pub mod suite;

pub use command::{BenchArgs, BenchError, Form, Verdict, run};
