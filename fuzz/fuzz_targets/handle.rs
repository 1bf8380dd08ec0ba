//! Fuzzes a communication task: any operations on any small cell. The task must accept every input in every state, and
//! its state must always fulfil its laws.
#![no_main]

#[allow(dead_code, reason = "a fuzz target uses a part of it")]
#[path = "../../protocol/tests/support/mod.rs"]
mod support;

libfuzzer_sys::fuzz_target!(|data: &[u8]| support::bytes::inputs(data));
