//! Fuzzes packets. The decoder must accept any bytes, and must undo the encoder.
#![no_main]

#[allow(dead_code, reason = "a fuzz target uses a part of it")]
#[path = "../../protocol/tests/support/mod.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::bytes::packets(data));
