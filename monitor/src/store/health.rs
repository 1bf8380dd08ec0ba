//! What is wrong, seen from what is known: each finding names its place and says what it means.

use super::journal::Level;
use super::meeting::{Meeting, meetings};
use super::{Condition, Life, LifeId, Presence, Store};
use crate::clock::{Moment, Span};
use crate::name::Name;
use imrs_protocol::{NodeId, PortCounters, PortId, TaskId};
use imrs_wire::obs::Liveness;

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
    /// A name that stays the same, for programs.
    pub code: &'static str,
    /// Where.
    pub place: Place,
    /// In words.
    pub text: String,
}

/// All that is wrong in a cell now, worst first.
#[must_use]
pub fn findings(store: &Store, cell: &Name, now: Moment) -> Vec<Finding> {
    let mut found = Vec::new();
    for life in store.lives_of(cell) {
        // An earlier life is history; the present one is what counts.
        if store.latest(cell, life.node_id).is_some_and(|latest| latest.id == life.id) {
            node(life, now, &mut found);
        }
    }
    for (id, _, killed) in store.unseen(cell) {
        if killed {
            let place = Place { node: Err(id), task: None, port: None };
            let text = "dead: its socket was left behind".to_owned();
            found.push(Finding { level: Level::Bad, code: "node-dead", place, text });
        }
    }
    for one in meetings(store, cell, now) {
        rendezvous(store, cell, &one, &mut found);
    }
    found.sort_by(|a, b| (b.level, a.place).cmp(&(a.level, b.place)));
    found
}

fn node(life: &Life, now: Moment, found: &mut Vec<Finding>) {
    let place = Place { node: Ok(life.id), task: None, port: None };
    let mut add = |level, code, place, text| found.push(Finding { level, code, place, text });
    match life.presence(now) {
        Presence::Dead(_) => {
            let why = match &life.condition {
                Condition::Dead { why, .. } => crate::name::shown(why),
                Condition::Attached | Condition::Stopped { .. } => String::new(),
            };
            add(Level::Bad, "node-dead", place, format!("dead, last state kept: {why}"));
            return;
        }
        Presence::Silent(since) => {
            add(Level::Warn, "node-silent", place, format!("silent for {}, though attached", Span(since)));
        }
        Presence::Stopped(_) => return,
        Presence::Up => {}
    }
    let Some(last) = &life.last else { return };
    let base = life.base.as_ref().map(|s| &s.snapshot);
    let before = |name: &str| {
        base.and_then(|s| s.link_discards.iter().find(|c| c.name == name)).map_or(0, |c| c.count)
    };
    for discard in &last.snapshot.link_discards {
        if base.is_some() && discard.count > before(&discard.name) {
            let text = format!("link drops: {}", crate::name::shown(&discard.name));
            add(Level::Warn, "link-discards", place, text);
        }
    }
    for task in &last.snapshot.tasks {
        let place = Place { task: Some(task.view.task), ..place };
        if task.liveness == Liveness::Crashed {
            add(Level::Bad, "task-crashed", place, "the task panicked".to_owned());
        }
        let earlier = base.and_then(|s| s.tasks.iter().find(|t| t.view.task == task.view.task));
        for port in &task.view.ports {
            let place = Place { port: Some(port.port), ..place };
            let earlier = earlier.and_then(|t| t.view.ports.iter().find(|p| p.port == port.port));
            if let Some((code, text)) = earlier.and_then(|e| grown(&e.counters, &port.counters)) {
                add(Level::Warn, code, place, text);
            }
            let whole = life.names.port(port.port).and_then(|p| p.time_out(task.view.task));
            // As the node saw it: between two snapshots a short-lived message comes and goes, and counting its time
            // down here would raise an alarm about one that was taken long ago.
            let left = port.min_slack.map(|s| life.left_when_seen(s, task.age_us));
            if let (Some(left), Some(whole)) = (left, whole)
                && left < whole.0.saturating_mul(life.tick_us) / 10
            {
                add(
                    Level::Warn,
                    "deadline-risk",
                    place,
                    "expiring: a message has a tenth of its life left".to_owned(),
                );
            }
        }
    }
}

/// What a port has lost lately, the most telling first.
fn grown(before: &PortCounters, after: &PortCounters) -> Option<(&'static str, String)> {
    let rows = [
        ("time-outs", "time-outs of requests", before.timed_out, after.timed_out),
        ("refused", "refused for space", before.refused, after.refused),
        ("evicted", "evicted for space", before.evicted, after.evicted),
        ("expired", "expired", before.expired, after.expired),
    ];
    let row = rows.into_iter().find(|(_, _, before, after)| after > before)?;
    Some((row.0, format!("{} (+{})", row.1, row.3 - row.2)))
}

/// A meeting in which somebody waits for one who is no more.
fn rendezvous(store: &Store, cell: &Name, meeting: &Meeting, found: &mut Vec<Finding>) {
    let lost: Vec<String> = meeting.lost().map(|m| format!("{}@{}", m.name, m.node)).collect();
    let Some(names) = store.names(cell) else { return };
    for member in meeting.members.iter().filter(|m| !m.is_gone() && !m.waits_for.is_empty()) {
        let life = names.home(member.task).and_then(|node| store.latest(cell, node));
        let Some(life) = life else { continue };
        let place = Place { node: Ok(life.id), task: Some(member.task), port: Some(meeting.port) };
        if !lost.is_empty() {
            let text = format!("lost {}: waits in vain", lost.join(", "));
            found.push(Finding { level: Level::Bad, code: "rendezvous-lost-member", place, text });
        } else if member.within_margin {
            let text = "too late: all arrived, only a CONFIRM can help".to_owned();
            found.push(Finding { level: Level::Warn, code: "within-margin", place, text });
        }
    }
}
