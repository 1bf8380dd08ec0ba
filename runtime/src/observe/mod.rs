//! How a node looks from outside: its observations, snapshots of it, and the socket that monitors come to.

pub(crate) mod lateness;
pub mod observer;
pub(crate) mod ring;
pub(crate) mod snapshot;
pub(crate) mod vitals;
