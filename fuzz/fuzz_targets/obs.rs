//! Fuzzes observation frames. The decoder must accept any bytes. A delta that is applied to any state must either give
//! the right state or fail.
#![no_main]

#[path = "../../wire/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
