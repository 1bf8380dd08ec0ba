//! The UDP link on real loopback sockets.

mod faults;
mod hostile;
mod rig;
mod time;
mod traffic;
