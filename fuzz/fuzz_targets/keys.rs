//! Fuzzes sessions with keys: whatever the network does to datagrams, none is taken in twice or made up, and the two talk again.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| imrs_runtime::link::udp::keys::bytes::check(data));
