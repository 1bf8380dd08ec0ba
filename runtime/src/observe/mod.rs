//! Everything that a node shows: its observations, its snapshots, and the socket for monitors.

pub(crate) mod batch;
pub(crate) mod lateness;
pub(crate) mod observations;
pub mod observer;
pub(crate) mod ring;
pub(crate) mod snapshot;
pub(crate) mod vitals;
