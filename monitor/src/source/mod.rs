//! Where the monitor's knowledge comes from. A running node, a recording and a test look alike from here on.

pub mod live;
mod session;
mod wishes;

pub use wishes::{Wanted, Wishes};

use crate::clock::{Clock, Moment};
use crate::conformance::Conformance;
use crate::error::MonitorError;
use imrs_wire::obs::{NodeIdentity, ServerFrame};
use std::sync::Arc;

/// One connection, or what stands for one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SourceId(pub u32);

/// What a source has to say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Feed {
    /// The source is attached to a node.
    Attached {
        /// Which.
        identity: NodeIdentity,
        /// Its process.
        pid: u32,
        /// Its program.
        build: String,
    },
    /// The node said something.
    Frame(Box<ServerFrame>),
    /// The validator has judged what a node recorded. Comes from no node: it names the one that it is about.
    Judged {
        /// The name of its cell.
        cell: String,
        /// Its name.
        node: String,
        /// Which of its lives.
        incarnation: u8,
        /// What it found.
        said: Box<Conformance>,
    },
    /// The source is no longer attached.
    Lost {
        /// Why, for people.
        why: String,
    },
    /// The source could not attach.
    Failed {
        /// Where and why, for people.
        why: String,
    },
    /// The source ends: its socket is gone.
    Left,
    /// A socket was found whose node is gone without having removed it: it was killed.
    Stale {
        /// What stands for the cell's name in a file name.
        cell: String,
        /// What stands for the node's name in a file name.
        node: String,
    },
}

/// Something that a source said, and when it came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// When it came.
    pub at: Moment,
    /// From where.
    pub source: SourceId,
    /// What.
    pub feed: Feed,
}

/// Where sources put what they have to say.
#[derive(Clone)]
pub struct Sink {
    clock: Clock,
    take: Arc<dyn Fn(Arrival) -> bool + Send + Sync>,
}

impl Sink {
    /// A sink that gives everything to `take`, which may wait, and which says whether it wants more.
    pub fn new(clock: Clock, take: impl Fn(Arrival) -> bool + Send + Sync + 'static) -> Self {
        Self { clock, take: Arc::new(take) }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Moment {
        self.clock.now()
    }

    /// Gives `feed` on with the present moment. `false`: nobody wants more, the source may end.
    #[must_use]
    pub fn deliver(&self, source: SourceId, feed: Feed) -> bool {
        (self.take)(Arrival { at: self.clock.now(), source, feed })
    }
}

/// Something that can feed a monitor.
pub trait Source {
    /// Begins to feed `sink` from threads of its own, until the sink wants no more or the source is dropped.
    ///
    /// # Errors
    /// Where it cannot even begin.
    fn start(&mut self, sink: Sink) -> Result<(), MonitorError>;
}

/// A source that says what it was given, at once: for tests and demonstrations.
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
