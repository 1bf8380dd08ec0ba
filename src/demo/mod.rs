//! `imrs demo`: the built-in cells, run as one process per node over loopback UDP.
//!
//! The launcher starts this program again for every node, collects the addresses of their sockets over pipes, hands the
//! address book round, injects the faults on time and sums up what the nodes tell. It is no part of the cell: no message
//! between nodes passes it.

mod beam_lift;
mod children;
mod clock;
mod faults;
mod launcher;
mod lines;
mod node;
mod probe;
mod recorder;
mod report;
mod summary;
mod tally;

pub use faults::{Cut, Kill, Rate};
pub use launcher::{DemoError, run};
pub use node::{NodeError, run as run_node};
