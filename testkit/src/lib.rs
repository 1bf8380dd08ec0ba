//! What tests of several rooms share: a node that one thread steps together with the scripts of its tasks ([`ScriptedNode`]),
//! and a whole cell of such nodes in virtual time ([`VirtualCell`]). No robot carries it.
#![forbid(unsafe_code)]

mod cell;
mod host;
pub mod words;

pub use cell::VirtualCell;
pub use host::{HostInput, HostOutbox, Hosted, ScriptedNode};
