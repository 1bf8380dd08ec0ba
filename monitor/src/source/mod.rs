//! The sources of the monitor's data. From here on a running node, a recording and a test look alike.

pub mod live;
mod session;
mod wishes;

pub use wishes::{Wanted, Wishes};

use crate::clock::{Clock, Moment};
use crate::conformance::Conformance;
use crate::error::MonitorError;
use imrs_wire::obs::{NodeIdentity, ServerFrame};
use std::sync::Arc;

/// Identifies a connection, or its equivalent in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SourceId(pub u32);

/// A message from a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Feed {
    /// The source is attached to a node.
    Attached {
        /// The node.
        identity: NodeIdentity,
        /// The process id.
        pid: u32,
        /// Name and version of the program.
        build: String,
    },
    /// The node sent a frame.
    Frame(Box<ServerFrame>),
    /// The validator's verdict on the recording of a node. It names its node, because it comes from no connection.
    Judged {
        /// The name of its cell.
        cell: String,
        /// Its name.
        node: String,
        /// Its incarnation.
        incarnation: u8,
        /// The verdict.
        said: Box<Conformance>,
    },
    /// The source is no longer attached.
    Lost {
        /// The reason, as text for people.
        why: String,
    },
    /// The source could not attach.
    Failed {
        /// The endpoint and the reason, as text for people.
        why: String,
    },
    /// The source ends, because its socket is gone.
    Left,
    /// A socket was left behind by a node that no longer runs: the node was killed.
    Stale {
        /// The cell's name as encoded in a file name.
        cell: String,
        /// The node's name as encoded in a file name.
        node: String,
    },
}

/// A message from a source, with its arrival.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The moment of arrival.
    pub at: Moment,
    /// The source.
    pub source: SourceId,
    /// The message.
    pub feed: Feed,
}

/// The receiver of what sources deliver.
#[derive(Clone)]
pub struct Sink {
    clock: Clock,
    take: Arc<dyn Fn(Arrival) -> bool + Send + Sync>,
}

impl Sink {
    /// A sink that passes everything to `take`. It may block, and returns whether it wants more.
    pub fn new(clock: Clock, take: impl Fn(Arrival) -> bool + Send + Sync + 'static) -> Self {
        Self { clock, take: Arc::new(take) }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Moment {
        self.clock.now()
    }

    /// Passes `feed` on with the present moment. Returns false if no more is wanted, so that the source may end.
    #[must_use]
    pub fn deliver(&self, source: SourceId, feed: Feed) -> bool {
        (self.take)(Arrival { at: self.clock.now(), source, feed })
    }
}

/// A source of data for a monitor.
pub trait Source {
    /// Starts to feed `sink` from its own threads, until the sink wants no more or the source is dropped.
    ///
    /// # Errors
    /// If it cannot start.
    fn start(&mut self, sink: Sink) -> Result<(), MonitorError>;
}

/// A source that delivers its contents at once, for tests and demonstrations.
#[derive(Debug, Default)]
pub struct Memory(pub Vec<(SourceId, Feed)>);

impl Source for Memory {
    fn start(&mut self, sink: Sink) -> Result<(), MonitorError> {
        for (source, feed) in self.0.drain(..) {
            if !sink.deliver(source, feed) {
                break;
            }
        }
        Ok(())
    }
}
