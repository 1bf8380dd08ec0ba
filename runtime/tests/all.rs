//! The tests of the runtime with real threads, one program: each file beside this one is a module of it. `process.rs` has
//! those that count or stop the whole process, `schedules` those of shuttle.

mod actuator;
mod busy;
mod common;
mod corruption;
mod futures;
mod handlers;
mod keyframes;
mod lives;
mod many;
mod masquerade;
mod nodes;
mod observer;
mod old_packets;
mod primitives;
mod recorder;
mod replay;
mod scripts;
mod time;
mod udp;
mod watching;
