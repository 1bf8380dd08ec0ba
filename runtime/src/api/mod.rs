//! The API of a program: how a node is built, what tasks may ask for, and what messages are.

pub(crate) mod builder;
#[doc(hidden)]
pub mod compiled;
pub(crate) mod context;
pub mod message;
