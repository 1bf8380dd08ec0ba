//! Fuzzes the nodes of a small cell with any operations. A fused step must do the same as the small steps that it
//! replaces.
#![no_main]

#[allow(dead_code, reason = "a fuzz target uses a part of it")]
#[path = "../../protocol/tests/support/mod.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::bytes::fused(data));
