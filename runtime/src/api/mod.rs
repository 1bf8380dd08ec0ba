//! The API for programs: how a node is built, what its tasks can do, and how messages are typed.

pub(crate) mod builder;
#[doc(hidden)]
pub mod compiled;
pub(crate) mod context;
pub mod message;
