//! Running a cell: one process per node over loopback UDP, or all nodes in one process.
//!
//! The launcher starts this program again for every node, collects the addresses of their sockets over pipes, hands the
//! address book round, injects the faults on time and sums up what the nodes tell. It is no part of the cell: no message
//! between nodes passes it.

mod children;
pub mod clock;
mod diary;
mod faults;
mod launcher;
mod lines;
mod node;
pub mod probe;
mod recorder;
mod report;
mod scripted;
mod summary;
mod tally;
mod way;

pub use faults::{ActionCommand, Cut, Kill, Rate};
pub use launcher::{LaunchError, Run, run};
pub use node::{NodeError, run_process as run_node};
