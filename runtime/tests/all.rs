//! The tests of the runtime with real threads, as one program. Most files beside this one are modules of it.
//! `process.rs` has the tests that count or stop the whole process; `schedules` has the tests with shuttle.

mod actuator;
mod busy;
mod common;
mod computing;
mod corruption;
mod domains;
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
mod ready;
mod recorded;
mod recorder;
mod replay;
mod scripts;
mod servers;
mod time;
mod told;
mod udp;
mod watching;
