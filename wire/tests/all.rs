//! The tests of the wire, one program: each file beside this one is a module of it.

mod envelope;
mod obs;
mod obs_bytes;
mod obs_delta;
mod obs_place;
mod recording;
mod support;
