//! Fuzzes a communication task with any operations on any small cell. The task must accept every input in every state,
//! and its invariants must hold after every input.
#![no_main]

#[allow(dead_code, reason = "a fuzz target uses a part of it")]
#[path = "../../protocol/tests/support/mod.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::bytes::inputs(data));
