//! Runs a cell: one process per node over loopback UDP, or all nodes in one process.
//!
//! The launcher starts its own executable once more for every node, and collects the addresses of the nodes' sockets
//! over pipes. It then distributes the address book, injects the faults on time, and takes the nodes' reports. It is
//! not part of the cell: no message between nodes passes through it.
//!
//! Every fact of a run passes once through the event log to the folds, each of which computes one result: the summary
//! with the outcomes of the rounds, the verdicts on the checks, the lines for people, the story for an explanation, the
//! tasks that still run, and the problems.
//!
//! ```text
//!   node processes --> Word --.
//!   faults, deaths, notices --+--> Fact --> event log --> folds --> Launcher::lines while it runs, Ended at its end
//! ```
//!
//! This crate prints nothing and knows no command line. The command `imrs` takes lines and results from it
//! ([`Launcher`]), and provides the few functions that a node needs of its program ([`Host`]).
#![forbid(unsafe_code)]

pub mod cells;
pub mod checks;
mod children;
mod clock;
mod error;
mod event_log;
mod fact;
mod faults;
mod folds;
mod host;
mod launcher;
mod node;
mod noticed;
mod pipe;
mod run;
pub mod script_event;
mod setups;
mod signals;
pub mod words;

pub use error::LaunchError;
pub use faults::Fault;
pub use folds::attendance::Attended;
pub use folds::joined::join;
pub use folds::links::{SecuritySummary, link_warnings};
pub use folds::report::{AfterKill, NodeReport, Report, ReportError, TaskSummary};
pub use folds::rounds::Rounds;
pub use folds::spans::Spans;
pub use folds::spread::Spread;
pub use folds::story::Story;
pub use folds::summary::{NodeSummary, Outcome, PortSummary, RendezvousSummary, Summary};
pub use folds::timeline::{Line, Telling};
pub use folds::trouble::Trouble;
pub use host::Host;
pub use launcher::{Ended, Launcher, StartedNode, Verdict};
pub use node::{NodeError, rt, run_process as run_node};
pub use pipe::{Figures, Outcomes, RefusalFigures};
pub use run::{Keys, Moment, Run};
pub use setups::record_file;
pub use signals::Interrupts;
