//! The sources of the monitor's data. The code after a source treats a running node, a recording and a test alike.

pub mod live;
mod session;
mod wishes;

pub use wishes::{Wanted, Wishes};

use crate::clock::{Clock, Moment};
use crate::conformance::Conformance;
use crate::error::MonitorError;
use imrs_wire::obs::{NodeIdentity, ServerFrame};
use std::sync::Arc;

/// Identifies a connection to a node, or its equivalent in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SourceId(pub u32);

/// A message from a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Feed {
    /// The source is attached to a node.
    Attached {
        /// The identity of the node.
        identity: NodeIdentity,
        /// The id of the node's process.
        pid: u32,
        /// The name and version of the node's program.
        build: String,
    },
    /// The node sent a frame.
    Frame(Box<ServerFrame>),
    /// The validator's verdict on the recording of a node. It names its node, because it comes from no connection.
    Judged {
        /// The name of the node's cell.
        cell: String,
        /// The name of the node.
        node: String,
        /// The incarnation of the node.
        incarnation: u8,
        /// The verdict on the node.
        said: Box<Conformance>,
    },
    /// The source has lost its connection to the node.
    Lost {
        /// The reason, as text for people.
        why: String,
    },
    /// The source could not attach to a node.
    Failed {
        /// The node's address and the reason, as text for people.
        why: String,
    },
    /// The source ends, because the node's socket is gone.
    Left,
    /// There is a socket of a node that does not run any more: the node was killed.
    Stale {
        /// The cell's name as encoded in a file name.
        cell: String,
        /// The node's name as encoded in a file name.
        node: String,
    },
}

/// A message from a source, with the moment of its arrival.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The moment at which the message arrived.
    pub at: Moment,
    /// The source that sent the message.
    pub source: SourceId,
    /// The message that arrived.
    pub feed: Feed,
}

/// The receiver of the messages that sources deliver.
#[derive(Clone)]
pub struct Sink {
    clock: Clock,
    take: Arc<dyn Fn(Arrival) -> bool + Send + Sync>,
}

impl Sink {
    /// Makes a sink that passes every message to `take`. `take` may block, and returns whether it wants more messages.
    pub fn new(clock: Clock, take: impl Fn(Arrival) -> bool + Send + Sync + 'static) -> Self {
        Self { clock, take: Arc::new(take) }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Moment {
        self.clock.now()
    }

    /// Passes `feed` on with the present moment. Returns false if the receiver wants no more messages, so that the
    /// source may end.
    #[must_use]
    pub fn deliver(&self, source: SourceId, feed: Feed) -> bool {
        (self.take)(Arrival { at: self.clock.now(), source, feed })
    }
}

/// A source of data for a monitor.
pub trait Source {
    /// Starts to feed `sink` from threads of its own, until the sink wants no more messages or the source is dropped.
    ///
    /// # Errors
    /// An error if the source cannot start.
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
