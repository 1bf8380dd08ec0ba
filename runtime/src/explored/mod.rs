//! The concurrent pieces of the runtime, each in small scenes of two or three threads. An explorer runs a scene under many
//! schedules: loom under all with so many preemptions, old values of atomics included, in the unit tests; shuttle under
//! chosen ones, many more, in `tests/schedules`. Both take these very files (`crate::explorer` is either).
//!
//! A scene returns what came out. Each test asserts the whole set of outcomes, and has twins with a planted bug that must
//! be found: an exploration that sees one outcome or misses the bug shows nothing.

mod handoff;
mod lead;
mod looks;
mod time;

/// What an explorer says when every thread sleeps.
const DEADLOCK: &str = "deadlock";
