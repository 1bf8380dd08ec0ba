//! Observation frames are decoded totally, and what changed leads from any state to the right one or to none.
#![no_main]

#[path = "../../wire/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
