//! Fuzzes datagrams that are protected with keys. Any bytes must decode to a datagram, to contents or to an error, and
//! decoding must undo encoding.
#![no_main]

#[path = "../../wire/tests/support/keyed.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::check(data));
