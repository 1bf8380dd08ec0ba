//! Everything that leaves a node as bytes, versioned, with golden bytes of every version in the tests.
#![forbid(unsafe_code)]

mod checksum;
pub mod envelope;
pub mod files;
pub mod obs;
pub mod recording;
pub mod text;
