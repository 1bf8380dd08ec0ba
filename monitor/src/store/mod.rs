//! The store: the state and the events of every observed node. It reads no clock and does no I/O.

pub mod blocked;
mod compare;
pub mod conformance;
pub mod coverage;
pub mod cuts;
mod earlier;
pub mod health;
mod incarnation;
pub mod journal;
mod left;
mod link_health;
pub mod meeting;
pub mod message;
mod names;
pub mod nearest;
mod presence;
pub mod queue;
pub mod recent;
pub mod rounds;
mod samples;
pub mod service;
pub mod timeline;
pub mod trail;
mod unseen;
pub mod waits;

pub use incarnation::{
    ClockOffset, Condition, IncarnationId, NodeIncarnation, Received, SILENT, Sample, Watched,
};
pub use left::Left;
pub use link_health::Measured;
pub use names::{Names, PortInfo, TaskInfo};
pub use presence::Presence;
pub use unseen::{Unseen, is_killed, unseen};

use crate::clock::Moment;
use crate::name::Name;
use crate::source::{Arrival, Feed, SourceId};
use imrs_protocol::NodeId;
use imrs_wire::obs::{Events, Goodbye, NodeIdentity, ServerFrame, Table};
use journal::{Entry, Journal, Severity, What};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use trail::Trail;

/// How many reasons for failed attempts to attach are kept.
const TROUBLES: usize = 64;

/// The state and the events of all observed nodes.
#[derive(Clone, Debug, Default)]
pub struct Store {
    /// All observed incarnations, sorted by cell, node and incarnation.
    incarnations: Vec<NodeIncarnation>,
    of_source: BTreeMap<SourceId, IncarnationId>,
    born: u32,
    journal: Journal,
    services: service::Services,
    histories: rounds::Histories,
    judged: conformance::Judged,
    trail: Trail,
    silences: cuts::Silences,
    /// For each source that cannot attach, the reason.
    troubles: BTreeMap<SourceId, String>,
    /// The nodes that left their sockets behind, as names of cells and nodes in the form for file names.
    killed: Vec<(String, String)>,
    /// How many deltas did not fit the last state.
    gaps: u64,
    /// Whether the data comes from running nodes: if so, all nodes of a cell should be present.
    is_live: bool,
}

impl Store {
    /// Makes a store for running nodes. The default store is for recordings, in which a missing node is normal.
    #[must_use]
    pub fn of_running_nodes() -> Self {
        Self { is_live: true, ..Self::default() }
    }

    /// Applies an arrival from a source to the store.
    pub fn apply(&mut self, arrival: Arrival) {
        let Arrival { at, source, feed } = arrival;
        match feed {
            Feed::Attached { identity, pid, build } => self.attach(at, source, &identity, pid, &build),
            Feed::Frame(frame) => self.frame(at, source, *frame),
            Feed::Judged { cell, node, incarnation, said } => self.judge((&cell, &node, incarnation), *said),
            Feed::Lost { why } => self.end(at, source, Condition::Dead { since: at, why }),
            Feed::Failed { why } => {
                if self.troubles.len() < TROUBLES || self.troubles.contains_key(&source) {
                    self.troubles.insert(source, why);
                }
            }
            Feed::Left => drop(self.troubles.remove(&source)),
            Feed::Stale { cell, node } => {
                self.troubles.remove(&source);
                if !self.killed.contains(&(cell.clone(), node.clone())) && self.killed.len() < TROUBLES {
                    self.killed.push((cell, node));
                }
            }
        }
    }

    /// All incarnations, sorted by cell, node and start.
    #[must_use]
    pub fn incarnations(&self) -> &[NodeIncarnation] {
        &self.incarnations
    }

    /// The incarnations of the nodes of one cell.
    pub fn incarnations_of<'a>(&'a self, cell: &Name) -> impl Iterator<Item = &'a NodeIncarnation> + use<'a> {
        let first = self.incarnations.partition_point(|l| l.names.cell < *cell);
        let after = self.incarnations.partition_point(|l| l.names.cell <= *cell);
        self.incarnations.get(first..after).unwrap_or_default().iter()
    }

    /// One incarnation.
    #[must_use]
    pub fn incarnation(&self, id: IncarnationId) -> Option<&NodeIncarnation> {
        self.incarnations.iter().find(|l| l.id == id)
    }

    /// The latest incarnation of a node of a cell.
    #[must_use]
    pub fn latest(&self, cell: &Name, node: NodeId) -> Option<&NodeIncarnation> {
        let upto = self.incarnations.partition_point(|l| (&l.names.cell, l.node_id) <= (cell, node));
        let last = self.incarnations.get(upto.checked_sub(1)?)?;
        (last.node_id == node && last.names.cell == *cell).then_some(last)
    }

    /// The latest incarnation of each node of a cell. Findings and rates ignore earlier incarnations.
    pub fn present<'a>(&'a self, cell: &'a Name) -> impl Iterator<Item = &'a NodeIncarnation> {
        self.incarnations_of(cell).filter(|incarnation| self.is_present(incarnation))
    }

    /// Whether an incarnation is the latest of its node.
    #[must_use]
    pub fn is_present(&self, incarnation: &NodeIncarnation) -> bool {
        self.latest(&incarnation.names.cell, incarnation.node_id)
            .is_some_and(|latest| latest.id == incarnation.id)
    }

    /// The known cells, sorted.
    #[must_use]
    pub fn cells(&self) -> Vec<Name> {
        // The incarnations are sorted by cell.
        self.incarnations
            .chunk_by(|a, b| a.names.cell == b.names.cell)
            .map(|of| of[0].names.cell.clone())
            .collect()
    }

    /// The names of a cell, as its nodes reported them.
    #[must_use]
    pub fn names(&self, cell: &Name) -> Option<&Arc<Names>> {
        self.incarnations_of(cell).map(|l| &l.names).max_by_key(|n| n.nodes.len())
    }

    /// How many deltas did not fit the last state. If this number grows, the monitor must ask for whole snapshots.
    #[must_use]
    pub const fn gaps(&self) -> u64 {
        self.gaps
    }

    /// The approximate memory of the states, the events and the statistics, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        let states: usize = self.incarnations.iter().map(NodeIncarnation::weight).sum();
        states + self.journal.weight() + self.trail.weight() + self.services.weight()
    }

    /// The source that is attached to an incarnation, if any.
    #[must_use]
    pub fn source_of(&self, incarnation: IncarnationId) -> Option<SourceId> {
        self.of_source.iter().find(|(_, id)| **id == incarnation).map(|(source, _)| *source)
    }

    /// The event log.
    #[must_use]
    pub const fn journal(&self) -> &Journal {
        &self.journal
    }

    /// The single observations of the state machines.
    #[must_use]
    pub const fn trail(&self) -> &Trail {
        &self.trail
    }

    /// The reasons why sources cannot attach.
    pub fn troubles(&self) -> impl Iterator<Item = &str> {
        self.troubles.values().map(String::as_str)
    }

    fn attach(&mut self, at: Moment, source: SourceId, identity: &NodeIdentity, pid: u32, build: &str) {
        self.troubles.remove(&source);
        let (cell, node) = (Name::new(&identity.cell), Name::new(&identity.node));
        let same = |l: &&mut NodeIncarnation| {
            l.names.cell == cell && l.node == node && (l.number, l.pid) == (identity.incarnation.0, pid)
        };
        if let Some(incarnation) = self.incarnations.iter_mut().find(same) {
            incarnation.condition = Condition::Attached;
            (incarnation.heard, incarnation.resumed) = (at, at);
            // A node found through two sources keeps only the newer one, because deltas continue one connection.
            let id = incarnation.id;
            self.of_source.retain(|_, other| *other != id);
            self.of_source.insert(source, id);
            return;
        }
        let id = IncarnationId(self.born);
        self.born += 1;
        let names = self.incarnations.iter().find(|l| l.names.cell == cell && l.digest == identity.digest);
        let names = names.map_or_else(|| Arc::new(Names::unknown(&identity.cell)), |l| l.names.clone());
        let incarnation = NodeIncarnation {
            id,
            node,
            node_id: NodeId(identity.id),
            number: identity.incarnation.0,
            pid,
            build: Name::new(build),
            digest: identity.digest,
            tick_us: identity.tick_us,
            condition: Condition::Attached,
            heard: at,
            resumed: at,
            names,
            last: None,
            base: None,
            next_base: None,
            lost: 0,
            lost_before: (0, 0),
            longest: BTreeMap::new(),
            vitals: None,
            links: None,
            held_back: None,
            timers: VecDeque::new(),
            watched: Vec::new(),
            clock: None,
            looked: health::Looked::default(),
            recent: recent::Recent::default(),
            buried: 0,
        };
        let is_it =
            |l: &NodeIncarnation| (&l.names.cell, &l.node) == (&incarnation.names.cell, &incarnation.node);
        let again = self.incarnations.iter().any(is_it);
        // A node of the checker's counterexample has no process.
        let process = if pid == 0 { String::new() } else { format!("pid {pid}, ") };
        let detail = format!("incarnation {}, {process}{}", incarnation.number, incarnation.build);
        let kind = if again { "restart" } else { "attached" };
        self.notice(at, &incarnation, Severity::Note, kind, String::new(), detail);
        self.of_source.insert(source, id);
        self.incarnations.push(incarnation);
        self.incarnations
            .sort_by(|a, b| (&a.names.cell, a.node_id, a.id).cmp(&(&b.names.cell, b.node_id, b.id)));
        self.forget_early_incarnations();
    }

    fn frame(&mut self, at: Moment, source: SourceId, frame: ServerFrame) {
        let Some(index) = self.index_of(source) else { return };
        let incarnation = &mut self.incarnations[index];
        if at.saturating_sub(incarnation.heard) > SILENT / 2 {
            incarnation.resumed = at;
        }
        incarnation.heard = at;
        incarnation.looked.forget();
        match frame {
            ServerFrame::Table(table) => self.table(index, table),
            ServerFrame::Snapshot(snapshot) => self.state(at, index, |incarnation| {
                incarnation.take(at, snapshot);
                true
            }),
            ServerFrame::Delta(delta) => self.state(at, index, |incarnation| incarnation.change(at, &delta)),
            ServerFrame::Detail(detail) => self.incarnations[index].look_at(at, detail),
            ServerFrame::Vitals(vitals) => self.incarnations[index].feel(at, vitals),
            ServerFrame::Links(links) => self.links(at, index, links),
            ServerFrame::HeldBack(what) => self.incarnations[index].held_back = Some(Received { at, what }),
            ServerFrame::Pong(pong) => self.incarnations[index].compare_clocks(at, pong),
            // The source has already handled these frames.
            ServerFrame::Places(_) | ServerFrame::Denied(_) | ServerFrame::Challenge(_) => {}
            ServerFrame::Events(events) => self.events(at, index, events),
            ServerFrame::Bye(bye) => match bye.reason {
                Goodbye::Stopping => self.end(at, source, Condition::Stopped { since: at }),
                // The connection closes right after this, and its end is handled then.
                Goodbye::Misunderstood => {}
            },
        }
    }

    /// The incarnation to which a source is attached.
    #[must_use]
    pub fn incarnation_of(&self, source: SourceId) -> Option<&NodeIncarnation> {
        self.incarnation(*self.of_source.get(&source)?)
    }

    fn index_of(&self, source: SourceId) -> Option<usize> {
        self.of_source.get(&source).and_then(|id| self.incarnations.iter().position(|l| l.id == *id))
    }

    /// Stores the names of a cell. The cell's name comes from the node's hello, not from its table.
    fn table(&mut self, index: usize, table: Table) {
        let cell = self.incarnations[index].names.cell.raw().to_owned();
        let told = Names::new(Table { cell, ..table });
        // All nodes of a cell report the same names, so they are kept once.
        let known = self.incarnations.iter().find(|l| *l.names == told).map(|l| Arc::clone(&l.names));
        self.incarnations[index].names = known.unwrap_or_else(|| Arc::new(told));
    }

    /// Applies a snapshot or delta with `change`, which returns false if the delta does not fit.
    fn state(&mut self, at: Moment, index: usize, change: impl FnOnce(&mut NodeIncarnation) -> bool) {
        let before = self.incarnations[index].notable();
        if change(&mut self.incarnations[index]) {
            let incarnation = &self.incarnations[index];
            if let Some(last) = &incarnation.last {
                self.services.sampled(incarnation.id, incarnation.tick_us, &last.snapshot);
            }
            let mut silences = std::mem::take(&mut self.silences);
            silences.sampled(self, incarnation);
            self.silences = silences;
            self.compare(at, index, before);
        } else {
            self.gaps += 1;
        }
    }

    fn events(&mut self, at: Moment, index: usize, events: Events) {
        let incarnation = &mut self.incarnations[index];
        self.trail.take(at, incarnation.id, &events);
        let newest = events.events.iter().map(|e| e.mono_us).max().unwrap_or(0);
        incarnation.lost = incarnation.lost.saturating_add(events.lost);
        let last = incarnation.last.as_ref().map(|last| &*last.snapshot);
        self.services.happened(incarnation.id, last, &events);
        for event in events.events {
            let what = What::Observed { task: event.task, observation: event.what };
            let earlier = std::time::Duration::from_micros(newest - event.mono_us);
            let at = at.saturating_sub(earlier);
            if let Some(task) = event.task {
                let round = (event.what.port, event.what.number);
                self.histories.happened(&incarnation.names.cell, task, at, event.what.event, round);
            }
            self.journal.add(Entry::new(at, incarnation, what, 1));
        }
        if events.lost > 0 {
            let what = What::Noticed {
                level: Severity::Note,
                kind: "lost",
                object: String::new(),
                detail: "events the node could not keep for this monitor".to_owned(),
            };
            self.journal.add(Entry::new(at, incarnation, what, events.lost));
        }
    }

    /// Stores the validator's verdict on a node; a verdict on an unknown node is dropped.
    fn judge(&mut self, (cell, node, incarnation): (&str, &str, u8), said: conformance::Conformance) {
        let one = |l: &&NodeIncarnation| {
            l.names.cell.raw() == cell && l.node.raw() == node && l.number == incarnation
        };
        if let Some(incarnation) = self.incarnations.iter().rfind(one) {
            self.judged.insert(incarnation.id, Arc::new(said));
        }
    }

    fn end(&mut self, at: Moment, source: SourceId, condition: Condition) {
        let Some(index) = self.index_of(source) else { return };
        // After an orderly goodbye, the end of the connection is no event.
        if self.incarnations[index].condition != Condition::Attached {
            return;
        }
        let incarnation = self.incarnations[index].clone();
        let (level, kind, detail) = match &condition {
            Condition::Dead { why, .. } => (Severity::Bad, "dead", crate::name::shown(why)),
            Condition::Stopped { .. } | Condition::Attached => {
                (Severity::Note, "stopped", "in order".to_owned())
            }
        };
        self.notice(at, &incarnation, level, kind, String::new(), detail);
        self.incarnations[index].condition = condition;
    }

    fn notice(
        &mut self,
        at: Moment,
        incarnation: &NodeIncarnation,
        level: Severity,
        kind: &'static str,
        object: String,
        detail: String,
    ) {
        let what = What::Noticed { level, kind, object, detail };
        self.journal.add(Entry::new(at, incarnation, what, 1));
    }
}
