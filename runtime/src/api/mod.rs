//! What a program says: how a node is built, what tasks ask for, and what messages are.

pub(crate) mod builder;
#[doc(hidden)]
pub mod compiled;
pub(crate) mod context;
pub mod message;
