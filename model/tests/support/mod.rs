//! What the tests and the benchmark share.

pub mod reference;
pub mod structural;
pub mod walk;
pub mod worlds;
