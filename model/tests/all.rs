//! All tests of this crate in one program, so that it is linked once.

mod agreement;
mod cell_examples;
mod cell_findings;
mod cell_state;
mod cell_state_packed;
mod cells;
mod checks;
mod claims;
mod couples;
mod faulty_cells;
mod guard;
mod inside;
mod outside;
mod parts;
mod pauses;
mod ranges;
mod reductions;
mod rules;
mod simulate;
mod standstill;
mod support;
mod traps;
mod unfinished;
mod verdicts;
mod zones;
