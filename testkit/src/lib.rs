//! Code that the tests of several crates share: a node that one thread steps together with the scripts of its tasks
//! ([`ScriptedNode`]), and a whole cell of such nodes in virtual time ([`VirtualCell`]). No program of a robot contains this
//! crate.
#![forbid(unsafe_code)]

mod cell;
mod host;
pub mod words;

pub use cell::VirtualCell;
pub use host::{HostInput, HostOutbox, Hosted, ScriptedNode};
