//! placeholder
#![no_std]
#![forbid(unsafe_code)]
extern crate alloc;
pub mod ids;
pub mod packet;
pub mod ticks;
