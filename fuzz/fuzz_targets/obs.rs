//! Fuzzes observation frames: the decoder accepts any bytes, and a change leads from any state to the right one or to none.
#![no_main]

#[path = "../../wire/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
