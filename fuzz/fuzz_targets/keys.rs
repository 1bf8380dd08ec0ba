//! Fuzzes sessions with keys. Whatever the network does to datagrams, no node accepts one twice or accepts a forged
//! one, and in the end the two nodes communicate again.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| imrs_runtime::link::udp::keys::bytes::check(data));
