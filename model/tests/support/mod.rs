//! Code that the tests of this crate share with its benchmark.

pub mod reference;
pub mod structural;
pub mod walk;
pub mod worlds;
