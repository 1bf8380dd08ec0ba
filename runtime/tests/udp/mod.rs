//! The UDP link on real loopback sockets.

mod faults;
mod hostile;
mod network;
mod rig;
mod segments;
mod time;
mod traffic;
