//! Findings of a node as a whole, and of its tasks.

use super::{Finding, Lately, Place, codes, links, port};
use crate::clock::{Moment, Span};
use crate::name::Name;
use crate::store::conformance::{Verdict, conformance};
use crate::store::{Condition, NodeIncarnation, Presence, Store, Unseen, unseen};
use imrs_wire::obs::{Liveness, RealTime};
use std::collections::BTreeMap;
use std::time::Duration;

/// For how long a node's report on its timers is used.
const VITALS: Duration = Duration::from_secs(3);
/// If fewer timers than this have ended, their lateness is no finding.
const A_RULE: u64 = 8;

pub(super) fn look(store: &Store, incarnation: &NodeIncarnation, now: Moment, found: &mut Vec<Finding>) {
    let place = Place::node(incarnation);
    match incarnation.presence(now) {
        Presence::Dead(_) => {
            let why = match &incarnation.condition {
                Condition::Dead { why, .. } => crate::name::shown(why),
                Condition::Attached | Condition::Stopped { .. } => String::new(),
            };
            found.push(Finding::new(&codes::NODE_DEAD, place, format!("dead, last state kept: {why}")));
            return;
        }
        Presence::Silent(since) => {
            let text = format!("silent for {}, though attached", Span(since));
            found.push(Finding::new(&codes::NODE_SILENT, place, text));
        }
        Presence::Stopped(_) => return,
        Presence::Up => {}
    }
    if let Verdict::Violates { step, what } = conformance(store, incarnation.id).verdict {
        let text = format!("does not do what was verified: step {step}: {}", crate::name::shown_line(&what));
        found.push(Finding::new(&codes::MODEL_VIOLATION, place, text));
    }
    let Some(lately) = Lately::of(incarnation) else { return };
    if let RealTime::Refused { memory, scheduler, core } = lately.after.real_time {
        let all = [(scheduler, "the scheduler"), (memory, "locked memory"), (core, "the core")];
        let refused: Vec<_> = all.into_iter().filter_map(|(is, what)| is.then_some(what)).collect();
        let text = format!("real time was refused: {}", refused.join(", "));
        found.push(Finding::new(&codes::NO_REAL_TIME, place, text));
    }
    held_back(incarnation, now, found);
    let lost = incarnation.lost_lately();
    if lost > 0 {
        let text = format!("{lost} events were lost between the node and this monitor");
        found.push(Finding::new(&codes::EVENTS_LOST, place, text));
    }
    timers(incarnation, now, found);
    links::look(incarnation, &lately, found);
    links::measured(incarnation, now, found);
    found.extend_from_slice(incarnation.looked.or_look(|| tasks(store, incarnation, &lately)));
}

fn tasks(store: &Store, incarnation: &NodeIncarnation, lately: &Lately<'_>) -> Vec<Finding> {
    let mut found = Vec::new();
    for task in &lately.after.tasks {
        if task.liveness == Liveness::Crashed {
            let place = Place { task: Some(task.view.task), ..Place::node(incarnation) };
            found.push(Finding::new(&codes::TASK_CRASHED, place, "the task panicked".to_owned()));
        }
        port::look(store, incarnation, lately, task, &mut found);
    }
    found
}

/// Reports the scripts that a restarted node holds back: one finding if all tasks have the same remaining time,
/// otherwise one finding each.
fn held_back(incarnation: &NodeIncarnation, now: Moment, found: &mut Vec<Finding>) {
    let held: Vec<_> = incarnation.held_back(now).collect();
    let Some(&(_, first)) = held.first() else { return };
    let alike = held.len() == incarnation.tasks().len() && held.iter().all(|(_, us)| *us == first);
    if alike {
        found.push(Finding::new(&codes::HELD_BACK, Place::node(incarnation), held_back_sentence(first)));
        return;
    }
    for (task, us) in held {
        let place = Place { task: Some(task), ..Place::node(incarnation) };
        found.push(Finding::new(&codes::HELD_BACK, place, held_back_sentence(us)));
    }
}

/// The words for a held-back script: "held back 62 s more". Seconds are rounded up.
pub(crate) fn held_back_words(us: u64) -> String {
    format!("held back {} s more", us.div_ceil(1_000_000))
}

/// The words for a held-back script, with the reason.
pub(crate) fn held_back_sentence(us: u64) -> String {
    format!("{}: commands of its earlier incarnation may still arrive", held_back_words(us))
}

/// Reports timers that are usually late, if enough of them ended within the last seconds. Single timers are late on any
/// shared machine; only the timer screen shows those.
fn timers(incarnation: &NodeIncarnation, now: Moment, found: &mut Vec<Finding>) {
    let Some(told) = incarnation.vitals.as_ref().filter(|told| now.saturating_sub(told.at) <= VITALS) else {
        return;
    };
    let Some(lately) = incarnation.timers_lately() else { return };
    let tick_us = incarnation.names.tick.0.saturating_mul(incarnation.tick_us);
    if lately.count >= A_RULE && lately.late.saturating_mul(2) > lately.count {
        let text = format!(
            "timers are late: {} of the last {} by more than the tick of {}, half of the newest by {} or more",
            lately.late,
            lately.count,
            Span::micros(tick_us),
            Span::micros(told.what.timer.p50_us)
        );
        found.push(Finding::new(&codes::TIMER_LATE, Place::node(incarnation), text));
    }
}

/// Reports nodes that the monitor has never seen: killed nodes, whose socket was left behind, and missing ones.
pub(super) fn never_seen(store: &Store, cell: &Name, found: &mut Vec<Finding>) {
    let is_gone = |one: &Unseen| store.is_said_to_have_stopped(cell, one.node);
    for one in unseen(store, cell).into_iter().filter(|one| !is_gone(one)) {
        let place = Place { node: Err(one.node), task: None, port: None };
        if one.is_killed {
            found.push(Finding::new(&codes::NODE_DEAD, place, "dead: its socket was left behind".to_owned()));
        } else if store.is_live {
            let text = "never seen: the cell declares it, and nothing answers for it".to_owned();
            found.push(Finding::new(&codes::NODE_MISSING, place, text));
        }
    }
}

/// Reports nodes that differ in digest or release from at least as many nodes of their cell as they agree with. If two
/// nodes differ, only a person knows which one is right, so both are reported.
pub(super) fn unlike(store: &Store, cell: &Name, now: Moment, found: &mut Vec<Finding>) {
    let up: Vec<&NodeIncarnation> =
        store.present(cell).filter(|incarnation| !incarnation.presence(now).is_gone()).collect();
    for (incarnation, digest, other) in minorities(&up, |incarnation| incarnation.digest) {
        let text =
            format!("runs another text of the cell: digest {digest:08x}, other nodes have {other:08x}");
        found.push(Finding::new(&codes::DIGEST_MISMATCH, Place::node(incarnation), text));
    }
    for (incarnation, build, other) in minorities(&up, |incarnation| incarnation.build.clone()) {
        let text = format!("is of another release: {build}, other nodes are {other}");
        found.push(Finding::new(&codes::VERSION_MISMATCH, Place::node(incarnation), text));
    }
}

/// The nodes with a value that is not in the majority: some other value is at least as frequent. Each node comes with
/// its own value and the most frequent other value.
fn minorities<'a, T: Ord + Clone>(
    nodes: &[&'a NodeIncarnation],
    of: impl Fn(&NodeIncarnation) -> T,
) -> Vec<(&'a NodeIncarnation, T, T)> {
    let mut count: BTreeMap<T, usize> = BTreeMap::new();
    for node in nodes {
        *count.entry(of(node)).or_default() += 1;
    }
    let other = |own: &T| {
        let others = count.iter().filter(|(value, _)| *value != own);
        others.max_by_key(|(_, times)| **times).filter(|(_, times)| **times >= count[own])
    };
    let differs = |node: &&'a NodeIncarnation| {
        let own = of(node);
        let other = other(&own)?.0.clone();
        Some((*node, own, other))
    };
    nodes.iter().filter_map(differs).collect()
}
