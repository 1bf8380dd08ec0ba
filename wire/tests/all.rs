//! The tests of this crate, built as one program: each file beside this one is a module.

mod envelope;
mod envelope_keyed;
mod obs;
mod obs_bytes;
mod obs_delta;
mod obs_later;
mod obs_place;
mod obs_token;
mod recording;
mod support;
