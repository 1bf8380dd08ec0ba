//! Runs one node of a cell. Tasks are threads, futures or scripts. A communication task is a data structure behind a
//! lock, and the thread that brings input runs it. One Timer thread sleeps until the next expiry. Links connect the
//! node to other nodes.
//!
//! There is no protocol here: every rule is in `imrs-protocol`, and this crate is one of its drivers.
//!
//! A robot's program that reads a cell file when it starts links `imrs-client`, which runs its nodes on this crate.
//! Link this crate and `imrs-macros` for a cell that is compiled into the program, with types for its messages. Link
//! this crate alone for a cell that is built in Rust, as in this example.
//!
//! ```
//! use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
//! use imrs_runtime::Runtime;
//! use std::{sync::Arc, time::Duration};
//!
//! let mut cell = Cell::new("greeting", Ticks(1_000));
//! let here = cell.node("here");
//! let (asker, answerer) = (cell.task("asker", here), cell.task("answerer", here));
//! cell.port(PortDecl::new("ask", asker, Usage::Send, &[answerer], Ticks(500_000)).command());
//! let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
//!
//! let node = Runtime::builder(table, here)
//!     .task("asker", |ctx| {
//!         let ask = ctx.port("ask")?;
//!         let answer = ctx.send(ask, b"how many?")?;
//!         assert_eq!(answer.reply().expect("an answer in time").as_bytes(), b"two");
//!         Ok(())
//!     })
//!     .task("answerer", |ctx| {
//!         let ask = ctx.port("ask")?;
//!         if let Some(question) = ctx.receive(Some(ask), None)? {
//!             ctx.reply(&question.from, b"two")?;
//!         }
//!         Ok(())
//!     })
//!     .start()
//!     .expect("a node that starts");
//! assert!(node.wait(Duration::from_secs(10)));
//! # let ends = node.stop(Duration::from_secs(10));
//! # assert!(ends.iter().all(|(_, end)| *end == imrs_runtime::TaskEnd::Returned), "{ends:?}");
//! ```

#![deny(unsafe_code)]

mod api;
mod clock;
#[cfg(test)]
mod explored;
#[cfg(test)]
mod explorer;
pub mod guard;
mod histogram;
pub mod link;
mod lock;
mod node;
mod observe;
pub mod record;
pub mod script;
mod sync;

pub use api::builder::{Builder, SPIN, TRANSIT_CAPACITY};
#[doc(hidden)]
pub use api::compiled;
pub use api::context::{
    Asked, AsyncContext, Context, MANY, Received, Rendezvous, RequestFault, Sent, TaskError,
};
pub use api::message::{self, Message};
pub use guard::actuator;
pub use imrs_protocol as protocol;
pub use node::Node;
pub use node::program::{StartError, TaskEnd};
pub use node::threads::{Runtime, SPIN_TAIL};
pub use observe::observations::Observations;
pub use observe::observer;
pub use observe::snapshot::Watching;

/// The time of the node's clock in microseconds, for benchmarks of how long a reading takes.
#[doc(hidden)]
#[must_use]
pub fn read_clock() -> u64 {
    clock::now()
}

/// Whether the node's clock comes from the processor's counter between two sleeps of a thread. Benchmarks ask this,
/// because their bounds depend on it.
#[doc(hidden)]
#[must_use]
pub fn is_by_counter() -> bool {
    clock::is_by_counter()
}
