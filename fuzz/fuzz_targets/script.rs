//! Fuzzes the scripts of tasks. A script must accept every input in every state, with any program.
#![no_main]
#![allow(dead_code, unused_imports, unused_macros, reason = "the tests that stand in the same files")]

#[path = "../../protocol/tests/script/mod.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| script::bytes::script(data));
