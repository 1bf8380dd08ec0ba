//! Fuzzes the cell compiler: parsing, reporting and formatting accept any bytes, and formatting keeps the meaning.
#![no_main]

#[path = "../../language/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
