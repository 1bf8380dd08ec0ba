//! Code that the tests of this crate share with its fuzz target.

pub mod bytes;
