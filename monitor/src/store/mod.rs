//! All that the monitor knows: the lives of the nodes and what happened in them. Reducers only: no clock, no I/O.

pub mod conformance;
pub mod coverage;
pub mod health;
pub mod journal;
mod life;
pub mod meeting;
pub mod message;
mod names;
pub mod queue;
pub mod rounds;
pub mod service;
pub mod timeline;
pub mod trail;
mod unseen;
pub mod waits;

pub use life::{ClockOffset, Condition, Left, Life, LifeId, Presence, SILENT, Sample, Told, Watched};
pub use names::{Names, PortInfo, TaskInfo};
pub use unseen::{Unseen, unseen};

use crate::clock::Moment;
use crate::name::Name;
use crate::source::{Arrival, Feed, SourceId};
use imrs_protocol::{NodeId, TaskId};
use imrs_wire::obs::{Count, Events, Goodbye, Liveness, NodeIdentity, ServerFrame, Table};
use journal::{Entry, Journal, Level, What};
use life::Notable;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use trail::Trail;

/// How many earlier lives of one node are kept beside the present one.
const EARLIER_LIVES: usize = 3;
/// How many troubles with attaching are kept.
const TROUBLES: usize = 64;

/// All that the monitor knows.
#[derive(Clone, Debug, Default)]
pub struct Store {
    /// In the order of cell, node and life.
    lives: Vec<Life>,
    of_source: BTreeMap<SourceId, LifeId>,
    born: u32,
    journal: Journal,
    services: service::Services,
    histories: rounds::Histories,
    judged: conformance::Judged,
    trail: Trail,
    /// For each source that cannot attach, why.
    troubles: BTreeMap<SourceId, String>,
    /// Cells and nodes, as file names, whose sockets were left behind.
    killed: Vec<(String, String)>,
    /// How often something changed in a state that was not there.
    gaps: u64,
    /// Whether running nodes tell it what it knows: all nodes of a cell should be there then.
    is_live: bool,
}

impl Store {
    /// What is known of running nodes. The default is of recordings, in which a node may be missing without being so.
    #[must_use]
    pub fn of_running_nodes() -> Self {
        Self { is_live: true, ..Self::default() }
    }

    /// Takes over what a source said.
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

    /// All lives, in the order of cell, node and life.
    #[must_use]
    pub fn lives(&self) -> &[Life] {
        &self.lives
    }

    /// The lives of the nodes of one cell.
    pub fn lives_of<'a>(&'a self, cell: &Name) -> impl Iterator<Item = &'a Life> + use<'a> {
        let first = self.lives.partition_point(|l| l.names.cell < *cell);
        let after = self.lives.partition_point(|l| l.names.cell <= *cell);
        self.lives.get(first..after).unwrap_or_default().iter()
    }

    /// One life.
    #[must_use]
    pub fn life(&self, id: LifeId) -> Option<&Life> {
        self.lives.iter().find(|l| l.id == id)
    }

    /// The latest life of a node of a cell.
    #[must_use]
    pub fn latest(&self, cell: &Name, node: NodeId) -> Option<&Life> {
        let upto = self.lives.partition_point(|l| (&l.names.cell, l.node_id) <= (cell, node));
        let last = self.lives.get(upto.checked_sub(1)?)?;
        (last.node_id == node && last.names.cell == *cell).then_some(last)
    }

    /// The present life of each node of a cell, or its last one: what an earlier life did is history.
    pub fn present<'a>(&'a self, cell: &'a Name) -> impl Iterator<Item = &'a Life> {
        self.lives_of(cell).filter(|life| self.is_present(life))
    }

    /// Whether a life is the latest of its node.
    #[must_use]
    pub fn is_present(&self, life: &Life) -> bool {
        self.latest(&life.names.cell, life.node_id).is_some_and(|latest| latest.id == life.id)
    }

    /// The cells that are known, sorted.
    #[must_use]
    pub fn cells(&self) -> Vec<Name> {
        // Lives stand in the order of their cells.
        self.lives.chunk_by(|a, b| a.names.cell == b.names.cell).map(|of| of[0].names.cell.clone()).collect()
    }

    /// The names of a cell, as its nodes told.
    #[must_use]
    pub fn names(&self, cell: &Name) -> Option<&Arc<Names>> {
        self.lives_of(cell).map(|l| &l.names).max_by_key(|n| n.nodes.len())
    }

    /// How often something changed in a state that was not there: whole snapshots are needed then.
    #[must_use]
    pub const fn gaps(&self) -> u64 {
        self.gaps
    }

    /// About how much memory the states take, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        self.lives.iter().map(Life::weight).sum()
    }

    /// From which source something is known of a life, if any is attached to it.
    #[must_use]
    pub fn source_of(&self, life: LifeId) -> Option<SourceId> {
        self.of_source.iter().find(|(_, id)| **id == life).map(|(source, _)| *source)
    }

    /// What happened.
    #[must_use]
    pub const fn journal(&self) -> &Journal {
        &self.journal
    }

    /// What the machines observed, one by one.
    #[must_use]
    pub const fn trail(&self) -> &Trail {
        &self.trail
    }

    /// Why sources cannot attach.
    pub fn troubles(&self) -> impl Iterator<Item = &str> {
        self.troubles.values().map(String::as_str)
    }

    fn attach(&mut self, at: Moment, source: SourceId, identity: &NodeIdentity, pid: u32, build: &str) {
        self.troubles.remove(&source);
        let (cell, node) = (Name::new(&identity.cell), Name::new(&identity.node));
        let same = |l: &&mut Life| {
            l.names.cell == cell && l.node == node && (l.incarnation, l.pid) == (identity.incarnation.0, pid)
        };
        if let Some(life) = self.lives.iter_mut().find(same) {
            life.condition = Condition::Attached;
            life.heard = at;
            // Found in two ways, it is heard in one: changes are reckoned from what the same connection told before.
            let id = life.id;
            self.of_source.retain(|_, other| *other != id);
            self.of_source.insert(source, id);
            return;
        }
        let id = LifeId(self.born);
        self.born += 1;
        let names = self.lives.iter().find(|l| l.names.cell == cell && l.digest == identity.digest);
        let names = names.map_or_else(|| Arc::new(Names::unknown(&identity.cell)), |l| l.names.clone());
        let life = Life {
            id,
            node,
            node_id: NodeId(identity.id),
            incarnation: identity.incarnation.0,
            pid,
            build: Name::new(build),
            digest: identity.digest,
            tick_us: identity.tick_us,
            condition: Condition::Attached,
            heard: at,
            names,
            last: None,
            base: None,
            next_base: None,
            lost: 0,
            lost_before: (0, 0),
            longest: BTreeMap::new(),
            vitals: None,
            held_back: None,
            timers: VecDeque::new(),
            watched: Vec::new(),
            clock: None,
            looked: health::Looked::default(),
        };
        let again = self.lives.iter().any(|l| l.names.cell == life.names.cell && l.node == life.node);
        // A node in a checker has no process.
        let process = if pid == 0 { String::new() } else { format!("pid {pid}, ") };
        let detail = format!("incarnation {}, {process}{}", life.incarnation, life.build);
        self.notice(
            at,
            &life,
            Level::Note,
            if again { "restart" } else { "attached" },
            String::new(),
            detail,
        );
        self.of_source.insert(source, id);
        self.lives.push(life);
        self.lives.sort_by(|a, b| (&a.names.cell, a.node_id, a.id).cmp(&(&b.names.cell, b.node_id, b.id)));
        self.forget_early_lives();
    }

    /// Drops the earliest gone lives of nodes that have had many.
    fn forget_early_lives(&mut self) {
        let later = |life: &Life| {
            let same = |l: &&Life| l.names.cell == life.names.cell && l.node == life.node && l.id > life.id;
            self.lives.iter().filter(same).count()
        };
        let gone = |life: &Life| life.condition != Condition::Attached;
        let forgotten: Vec<_> =
            self.lives.iter().filter(|l| gone(l) && later(l) > EARLIER_LIVES).map(|l| l.id).collect();
        self.lives.retain(|l| !forgotten.contains(&l.id));
        for id in forgotten {
            self.services.forget(id);
            self.judged.remove(&id);
        }
    }

    fn frame(&mut self, at: Moment, source: SourceId, frame: ServerFrame) {
        let Some(index) = self.index_of(source) else { return };
        self.lives[index].heard = at;
        self.lives[index].looked.forget();
        match frame {
            ServerFrame::Table(table) => self.table(index, table),
            ServerFrame::Snapshot(snapshot) => self.state(at, index, |life| {
                life.take(at, snapshot);
                true
            }),
            ServerFrame::Delta(delta) => self.state(at, index, |life| life.change(at, &delta)),
            ServerFrame::Detail(detail) => self.lives[index].look_at(at, detail),
            ServerFrame::Vitals(vitals) => self.lives[index].feel(at, vitals),
            ServerFrame::HeldBack(what) => self.lives[index].held_back = Some(Told { at, what }),
            ServerFrame::Pong(pong) => self.lives[index].compare_clocks(at, pong),
            // Who attaches to nodes takes these to heart.
            ServerFrame::Places(_) | ServerFrame::Denied(_) => {}
            ServerFrame::Events(events) => self.events(at, index, events),
            ServerFrame::Bye(bye) => match bye.reason {
                Goodbye::Stopping => self.end(at, source, Condition::Stopped { since: at }),
                // The connection ends after this; what follows decides.
                Goodbye::Misunderstood => {}
            },
        }
    }

    /// The life that a source speaks for.
    #[must_use]
    pub fn life_of(&self, source: SourceId) -> Option<&Life> {
        self.life(*self.of_source.get(&source)?)
    }

    fn index_of(&self, source: SourceId) -> Option<usize> {
        let id = self.of_source.get(&source)?;
        self.lives.iter().position(|l| l.id == *id)
    }

    /// The names belong to the cell that the node said it is of, whatever the table says.
    fn table(&mut self, index: usize, table: Table) {
        let cell = self.lives[index].names.cell.raw().to_owned();
        let told = Names::new(Table { cell, ..table });
        // All nodes of a cell tell the same: it is kept once.
        let known = self.lives.iter().find(|l| *l.names == told).map(|l| Arc::clone(&l.names));
        self.lives[index].names = known.unwrap_or_else(|| Arc::new(told));
    }

    /// A state is there after `change`, if that says so; it was told whole, or as what changed.
    fn state(&mut self, at: Moment, index: usize, change: impl FnOnce(&mut Life) -> bool) {
        let before = self.lives[index].notable();
        if change(&mut self.lives[index]) {
            let life = &self.lives[index];
            if let Some(last) = &life.last {
                self.services.sampled(life.id, life.tick_us, &last.snapshot);
            }
            self.compare(at, index, before);
        } else {
            self.gaps += 1;
        }
    }

    /// Notices what no machine observes: tasks that end, and what links drop.
    fn compare(&mut self, at: Moment, index: usize, before: Option<Notable>) {
        let (Some(before), Some(after)) = (before, self.lives[index].last.clone()) else { return };
        let after = &after.snapshot;
        let mut found = Vec::new();
        let was = |id: TaskId| before.tasks.iter().find(|(task, _)| *task == id).map(|(_, was)| *was);
        for task in &after.tasks {
            // Only who ends is looked up.
            if task.liveness == Liveness::Alive {
                continue;
            }
            let name = self.lives[index].names.task(task.view.task).to_string();
            match (was(task.view.task), task.liveness) {
                (Some(Liveness::Alive), Liveness::Crashed) => {
                    found.push((Level::Bad, "crashed", name, "the task panicked".to_owned(), 1));
                }
                (Some(Liveness::Alive), Liveness::Ended) => {
                    found.push((Level::Note, "ended", name, "the task returned".to_owned(), 1));
                }
                _ => {}
            }
        }
        let old = |name: &str| before.link_discards.iter().find(|c| c.name == name).map_or(0, |c| c.count);
        for Count { name, count } in &after.link_discards {
            let more = count.saturating_sub(old(name));
            if more > 0 {
                found.push((Level::Warn, "discard", "on a link".to_owned(), crate::name::shown(name), more));
            }
        }
        if found.is_empty() {
            return;
        }
        let life = self.lives[index].clone();
        for (level, kind, object, detail, times) in found {
            let what = What::Noticed { level, kind, object, detail };
            self.journal.add(Entry {
                number: 0,
                at,
                node: life.node.clone(),
                names: life.names.clone(),
                what,
                times,
            });
        }
    }

    fn events(&mut self, at: Moment, index: usize, events: Events) {
        let life = &mut self.lives[index];
        self.trail.take(at, life.id, &events);
        let newest = events.events.iter().map(|e| e.mono_us).max().unwrap_or(0);
        life.lost = life.lost.saturating_add(events.lost);
        self.services.happened(life.id, &events);
        for event in events.events {
            let what = What::Observed { task: event.task, observation: event.what };
            let earlier = std::time::Duration::from_micros(newest - event.mono_us);
            let at = at.saturating_sub(earlier);
            if let Some(task) = event.task {
                let round = (event.what.port, event.what.number);
                self.histories.happened(&life.names.cell, task, at, event.what.event, round);
            }
            self.journal.add(Entry {
                number: 0,
                at,
                node: life.node.clone(),
                names: life.names.clone(),
                what,
                times: 1,
            });
        }
        if events.lost > 0 {
            let what = What::Noticed {
                level: Level::Note,
                kind: "lost",
                object: String::new(),
                detail: "events the node could not keep for this monitor".to_owned(),
            };
            let (node, names) = (life.node.clone(), life.names.clone());
            self.journal.add(Entry { number: 0, at, node, names, what, times: events.lost });
        }
    }

    /// Takes over what the validator says of a node; of one that is not known it is of no use.
    fn judge(&mut self, (cell, node, incarnation): (&str, &str, u8), said: conformance::Conformance) {
        let one =
            |l: &&Life| l.names.cell.raw() == cell && l.node.raw() == node && l.incarnation == incarnation;
        if let Some(life) = self.lives.iter().rfind(one) {
            self.judged.insert(life.id, Arc::new(said));
        }
    }

    fn end(&mut self, at: Moment, source: SourceId, condition: Condition) {
        let Some(index) = self.index_of(source) else { return };
        // The connection's own end after an orderly goodbye adds nothing.
        if self.lives[index].condition != Condition::Attached {
            return;
        }
        let life = self.lives[index].clone();
        let (level, kind, detail) = match &condition {
            Condition::Dead { why, .. } => (Level::Bad, "dead", crate::name::shown(why)),
            Condition::Stopped { .. } | Condition::Attached => {
                (Level::Note, "stopped", "in order".to_owned())
            }
        };
        self.notice(at, &life, level, kind, String::new(), detail);
        self.lives[index].condition = condition;
    }

    fn notice(
        &mut self,
        at: Moment,
        life: &Life,
        level: Level,
        kind: &'static str,
        object: String,
        detail: String,
    ) {
        let what = What::Noticed { level, kind, object, detail };
        self.journal.add(Entry {
            number: 0,
            at,
            node: life.node.clone(),
            names: life.names.clone(),
            what,
            times: 1,
        });
    }
}
