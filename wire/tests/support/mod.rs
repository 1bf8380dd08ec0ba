//! Code that the tests of this crate share with its fuzz targets.

pub mod bytes;
pub mod keyed;
