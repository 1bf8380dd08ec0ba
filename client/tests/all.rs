//! The tests of this crate, built as one program.

mod program;
