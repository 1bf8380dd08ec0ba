//! Fuzzes observation frames: the decoder accepts any bytes, and a delta applied to any state either gives the right state
//! or fails.
#![no_main]

#[path = "../../wire/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
