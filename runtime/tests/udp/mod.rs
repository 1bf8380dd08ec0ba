//! Tests of the UDP link on real loopback sockets.

mod faults;
mod flood;
mod goodbye;
mod health;
mod hostile;
mod keys;
mod mutated;
mod network;
mod rig;
mod segments;
mod sessions;
mod time;
mod traffic;
