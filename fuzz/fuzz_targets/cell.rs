//! Fuzzes the cell compiler. The parser, the error reports and the formatter must accept any bytes, and formatting must
//! not change the meaning of a cell.
#![no_main]

#[path = "../../language/tests/support/bytes.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
