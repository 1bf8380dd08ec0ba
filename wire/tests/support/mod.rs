//! What the tests of the wire share with its fuzz target.

pub mod bytes;
