//! What the tests and the benchmark share.
#![allow(dead_code, reason = "each test uses a part")]

pub mod reference;
pub mod structural;
pub mod walk;
pub mod worlds;
