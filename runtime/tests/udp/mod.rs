//! The UDP link on real loopback sockets.

mod faults;
mod hostile;
mod mutated;
mod network;
mod rig;
mod segments;
mod sessions;
mod time;
mod traffic;
