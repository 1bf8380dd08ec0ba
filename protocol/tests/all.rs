//! The tests of the protocol as one program: each file beside this one is a module. `counts.rs` has the tests that count
//! allocations.

mod aging;
mod agreement;
mod answers;
mod buffers;
mod clocks;
mod copies;
mod fragments;
mod fuzzing;
mod laws;
mod lease;
mod lease_waits;
mod node;
mod order;
mod query;
mod restart;
mod script;
mod send;
mod sets;
mod steps;
mod support;
mod timer;
mod transit;
mod variants;
mod waitfor;
mod words;
