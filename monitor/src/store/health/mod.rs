//! What is wrong, seen from what is known: each finding names its place and says what it means.

pub mod codes;
mod links;
mod meetings;
mod node;
mod port;

pub(crate) use node::{held_back_sentence, held_back_words};

use super::journal::Level;
use super::{Life, LifeId, Store};
use crate::clock::Moment;
use crate::name::Name;
use codes::Lint;
use imrs_protocol::{NodeId, PortId, TaskId};
use imrs_wire::obs::Snapshot;
use std::sync::{Arc, OnceLock};

/// Where something is wrong: the whole node, one task, or one port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    /// The life of the node, or the node that was never seen.
    pub node: Result<LifeId, NodeId>,
    /// The task.
    pub task: Option<TaskId>,
    /// The port.
    pub port: Option<PortId>,
}

impl Place {
    /// A whole node.
    const fn node(life: &Life) -> Self {
        Self { node: Ok(life.id), task: None, port: None }
    }

    /// Whether `other` is this place or within it.
    #[must_use]
    pub fn holds(&self, other: &Self) -> bool {
        self.node == other.node
            && (self.task.is_none() || self.task == other.task)
            && (self.port.is_none() || self.port == other.port)
    }
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How much it matters.
    pub level: Level,
    /// A name that stays the same, for programs: see [`codes`].
    pub code: &'static str,
    /// Where.
    pub place: Place,
    /// In words.
    pub text: Arc<str>,
}

impl Finding {
    fn new(lint: &Lint, place: Place, text: String) -> Self {
        Self { level: lint.level, code: lint.code, place, text: text.into() }
    }
}

/// What is wrong with the tasks and ports of a life. It depends on what the node has told and not on the moment, so it is
/// looked for once after each time that the node says something: ten thousand ports in every frame would be most of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Looked(OnceLock<Arc<[Finding]>>);

impl Looked {
    fn or_look(&self, look: impl FnOnce() -> Vec<Finding>) -> &[Finding] {
        self.0.get_or_init(|| look().into())
    }

    /// The node has said something.
    pub(super) fn forget(&mut self) {
        self.0.take();
    }
}

/// All that is wrong in a cell now, worst first.
#[must_use]
pub fn findings(store: &Store, cell: &Name, now: Moment) -> Vec<Finding> {
    let mut found = Vec::new();
    for life in store.present(cell) {
        node::look(store, life, now, &mut found);
    }
    node::never_seen(store, cell, &mut found);
    node::unlike(store, cell, now, &mut found);
    meetings::look(store, cell, now, &mut found);
    found.sort_by(|a, b| (b.level, a.place).cmp(&(a.level, b.place)));
    found
}

/// How much a counter has grown since [`Life::base`], and the snapshot it stood in then.
struct Lately<'a> {
    before: Option<&'a Snapshot>,
    after: &'a Snapshot,
}

impl<'a> Lately<'a> {
    fn of(life: &'a Life) -> Option<Self> {
        let after = &life.last.as_ref()?.snapshot;
        Some(Self { before: life.base.as_ref().map(|s| &*s.snapshot), after })
    }
}
