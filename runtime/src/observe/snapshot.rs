//! Snapshots of a running node. A snapshot removes nothing from the node and advances no clock. Input that was left in
//! a task's inbox is handled first (D130), with the time at which it arrived.

use crate::clock;
use crate::link::LinkDiscard;
use crate::node::Node;
use crate::node::local_task::{BEGUN, LocalTask};
use crate::observe::observations::Observations;
use crate::sync::Ordering;
use imrs_protocol::{PortId, Reason, TaskId, Ticks};
use imrs_wire::obs::{
    Count, Detail, Gathering, HeldBack, HeldTask, LinkReports, LinkView, NodeIdentity, PortDetail, Snapshot,
    TimerEntry,
};
use std::sync::Arc;

/// The most waiting messages of a port that a snapshot shows.
pub(crate) const QUEUE_LIMIT: u8 = 64;

/// How much of a node a snapshot shows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Watching {
    /// How many waiting messages of each port are shown.
    pub queue_limit: usize,
    /// The ports of which all waiting messages are shown, at most 64 each.
    pub ports: Vec<(TaskId, PortId)>,
}

impl Watching {
    fn limit(&self, task: TaskId, port: PortId) -> usize {
        let watched = !self.ports.is_empty() && self.ports.contains(&(task, port));
        if watched { QUEUE_LIMIT.into() } else { self.queue_limit }
    }
}

impl Node {
    /// The node's introduction to a monitor.
    #[must_use]
    pub fn identity(&self) -> NodeIdentity {
        NodeIdentity {
            cell: self.table.cell().name.clone(),
            digest: self.table.digest(),
            node: self.name().into(),
            id: self.table.node.0,
            incarnation: self.incarnation,
            tick_us: 1,
        }
    }

    /// The state of the node, with at most `queue_limit` waiting messages of each port. The state machines are read one
    /// after the other, each under its own lock, so the parts of a snapshot are of slightly different instants.
    #[must_use]
    pub fn snapshot(&self, queue_limit: usize) -> Snapshot {
        self.snapshot_of(&Watching { queue_limit, ports: Vec::new() })
    }

    /// As [`snapshot`](Self::snapshot), with more waiting messages of the watched ports.
    #[must_use]
    pub fn snapshot_of(&self, watching: &Watching) -> Snapshot {
        let now = clock::now();
        let discards: [u64; Reason::ALL.len()] =
            std::array::from_fn(|reason| self.discards[reason].load(Ordering::Relaxed));
        let mut gathering = Gathering::new(discards);
        for local in &self.locals.list {
            let ((view, at), dropped) = self
                .look(local, |comm| (comm.view(|port| watching.limit(local.task, port)), *comm.discards()));
            gathering.task(local.liveness(), now.saturating_sub(at), view, &dropped);
        }
        let (transit, transit_at) = self.dispatch.view();
        let link_counts = LinkDiscard::NAMES.iter().zip(&self.link_discards);
        let link_counts = link_counts.map(|(name, n)| (*name, n.load(Ordering::Relaxed)));
        let failures = self.link.iter().flat_map(|link| link.failures());
        Snapshot {
            mono_us: now,
            uptime_us: now.saturating_sub(self.started),
            insecure: self.insecure,
            real_time: self.real_time,
            transit_age_us: now.saturating_sub(transit_at),
            timers: self.timer_entries(now),
            links: self.link_views(now),
            link_discards: link_counts.chain(failures).map(|(name, n)| named(name, n)).collect(),
            ..gathering.snapshot(transit)
        }
    }

    /// How long datagrams took on the node's links, and how many were damaged; empty if the link does not measure that.
    #[must_use]
    pub fn link_reports(&self) -> LinkReports {
        let links = self.link.iter().flat_map(|link| link.health());
        LinkReports { mono_us: clock::now(), links: links.collect() }
    }

    /// The tasks whose scripts have not begun yet because the node was restarted.
    #[must_use]
    pub fn held_back(&self) -> HeldBack {
        let now = clock::now();
        let held = |local: &LocalTask| {
            let begins = local.begins.load(Ordering::Relaxed);
            let is_held = begins > 0 && begins != BEGUN;
            is_held.then(|| HeldTask { task: local.task, remaining: Ticks(begins.saturating_sub(now)) })
        };
        HeldBack { mono_us: now, tasks: self.locals.list.iter().filter_map(held).collect() }
    }

    /// The waiting messages of the watched ports, as far as the node has these ports.
    #[must_use]
    pub fn detail(&self, ports: &[(TaskId, PortId)]) -> Detail {
        let now = clock::now();
        let one = |&(task, port): &(TaskId, PortId)| {
            let local = self.locals.of(task)?;
            let (queue, at) = self.look(local, |comm| comm.queue(port, QUEUE_LIMIT.into()))?;
            Some(PortDetail { task, port, age_us: now.saturating_sub(at), queue })
        };
        Detail { mono_us: now, ports: ports.iter().filter_map(one).collect() }
    }

    /// Begins to follow the node's observations from now on. Observations are kept only while a monitor follows.
    #[must_use]
    pub fn observe(self: &Arc<Self>) -> Observations {
        let tasks = self.locals.list.iter().map(|local| self.look(local, |comm| comm.ring().subscribe()));
        let positions = tasks.chain([self.dispatch.with_ring(|ring| ring.subscribe())]).collect();
        Observations::new(Arc::clone(self), positions)
    }

    fn timer_entries(&self, now: u64) -> Vec<TimerEntry> {
        let (entries, at) = self.timers.entries();
        let passed = imrs_protocol::Ticks(now.saturating_sub(at));
        let entry = |(owner, id, remaining)| TimerEntry { owner, id, remaining: remaining - passed };
        entries.into_iter().map(entry).collect()
    }

    fn link_views(&self, now: u64) -> Vec<LinkView> {
        let view = |(peer, (_, sent)): (&crate::node::Peer, (_, u64))| {
            let heard = peer.heard.load(Ordering::Relaxed);
            LinkView {
                peer: peer.node,
                heard_us: (heard != 0).then(|| now.saturating_sub(heard)),
                sent,
                received: peer.received.load(Ordering::Relaxed),
            }
        };
        self.peers.iter().zip(self.dispatch.sent()).map(view).collect()
    }
}

fn named(name: &str, count: u64) -> Count {
    Count { name: name.into(), count }
}
