//! The built-in cells.

pub mod beam_lift;
