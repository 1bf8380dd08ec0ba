//! The tests of this crate, built as one program: each file beside this one is a module.

mod program;
