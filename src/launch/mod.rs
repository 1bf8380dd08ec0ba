//! Runs a cell: one process per node over loopback UDP, or all nodes in one process.
//!
//! The launcher starts this executable again for every node and collects the addresses of their sockets over pipes. It then
//! distributes the address book, injects the faults on time, and sums up what the nodes report. It is not part of the cell:
//! no message between nodes passes through it.

mod children;
mod clock;
pub mod error;
mod event_log;
mod faults;
mod launcher;
mod lines;
mod message_queue;
mod node;
mod noticed;
mod recorder;
mod report;
mod rounds;
mod rt;
mod run;
pub mod script_event;
mod scripted;
mod settled;
mod setups;
mod signals;
mod spread;
pub mod story;
mod summary;
mod tally;
mod way;

pub use error::LaunchError;
pub use faults::{ActionCommand, Cut, Fault, Kill, Rate, Restart};
pub use launcher::run;
pub use node::{NodeError, run_process as run_node};
pub use run::Run;
pub use setups::record_file;
