//! Reading, reporting and formatting cell files is total, and formatting changes nothing that means something.
#![no_main]

#[path = "../../language/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
