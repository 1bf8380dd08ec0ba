//! The health checks, which derive findings from the store. Each finding names its place and its meaning.

pub mod codes;
mod links;
mod meetings;
mod node;
mod port;

pub(crate) use node::{held_back_sentence, held_back_words};

use super::journal::Severity;
use super::{IncarnationId, NodeIncarnation, Store};
use crate::clock::Moment;
use crate::name::Name;
use codes::Lint;
use imrs_protocol::{NodeId, PortId, TaskId};
use imrs_wire::obs::Snapshot;
use std::cmp::Reverse;
use std::sync::{Arc, OnceLock};

/// The place of a finding: a whole node, a task, or a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    /// The incarnation of the node, or the id of a node that the monitor has never seen.
    pub node: Result<IncarnationId, NodeId>,
    /// The task, if the place is a task or a port.
    pub task: Option<TaskId>,
    /// The port, if the place is a port.
    pub port: Option<PortId>,
}

impl Place {
    /// The place of the row that stands for the healthy nodes of a large cell. No cell has a node of this number.
    pub const HEALTHY: Self = Self { node: Err(NodeId(u16::MAX)), task: None, port: None };

    /// The place of a whole node.
    const fn node(incarnation: &NodeIncarnation) -> Self {
        Self { node: Ok(incarnation.id), task: None, port: None }
    }

    /// Whether `other` is this place or is within it.
    #[must_use]
    pub fn holds(&self, other: &Self) -> bool {
        self.node == other.node
            && (self.task.is_none() || self.task == other.task)
            && (self.port.is_none() || self.port == other.port)
    }
}

/// A finding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The severity of the finding.
    pub level: Severity,
    /// The code: a stable name, for programs. See [`codes`].
    pub code: &'static str,
    /// The place of the finding.
    pub place: Place,
    /// A description in words.
    pub text: Arc<str>,
}

impl Finding {
    fn new(lint: &Lint, place: Place, text: String) -> Self {
        Self { level: lint.level, code: lint.code, place, text: text.into() }
    }
}

/// Cached findings of the tasks and ports of an incarnation. They depend only on the incarnation's frames, so they are
/// computed once per received frame. Checking ten thousand ports for each drawn frame would take most of the drawing time.
#[derive(Clone, Debug, Default)]
pub(super) struct Looked(OnceLock<Arc<[Finding]>>);

impl Looked {
    fn or_look(&self, look: impl FnOnce() -> Vec<Finding>) -> &[Finding] {
        self.0.get_or_init(|| look().into())
    }

    /// Drops the cache after a frame of the node.
    pub(super) fn forget(&mut self) {
        self.0.take();
    }
}

/// All findings in a cell at `now`: the most severe first and, of equal severity, those that name a cause most directly.
#[must_use]
pub fn findings(store: &Store, cell: &Name, now: Moment) -> Vec<Finding> {
    let mut found = Vec::new();
    // Nodes with different cell texts also drop each other's datagrams, so the difference is listed before its
    // consequences.
    node::unlike(store, cell, now, &mut found);
    for incarnation in store.present(cell) {
        node::look(store, incarnation, now, &mut found);
    }
    node::never_seen(store, cell, &mut found);
    links::cut(store, cell, now, &mut found);
    meetings::look(store, cell, now, &mut found);
    let about = |finding: &Finding| codes::find(finding.code).map(|lint| lint.about);
    // A slight fault of a link must not displace what a port of the cell reports.
    found.sort_by_cached_key(|finding| (Reverse(finding.level), about(finding), finding.place));
    found
}

/// Two snapshots of a node that are compared: the one at [`NodeIncarnation::base`] and the latest.
struct Lately<'a> {
    before: Option<&'a Snapshot>,
    after: &'a Snapshot,
}

impl<'a> Lately<'a> {
    fn of(incarnation: &'a NodeIncarnation) -> Option<Self> {
        let after = &incarnation.last.as_ref()?.snapshot;
        Some(Self { before: incarnation.base.as_ref().map(|s| &*s.snapshot), after })
    }
}
