//! Fuzzes datagrams with keys: any bytes are a datagram, a content or an error, and encoding undoes decoding.
#![no_main]

#[path = "../../wire/tests/support/keyed.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
