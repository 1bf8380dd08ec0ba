//! The bytes that leave a node: datagrams, the observation protocol and recordings. Every format has a version, and the
//! tests keep golden bytes of each.
#![forbid(unsafe_code)]

mod checksum;
pub mod envelope;
pub mod files;
pub mod obs;
pub mod recording;
pub mod text;
