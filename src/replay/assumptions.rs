//! Finds the assumptions of the checks that a run did not keep.

use super::surroundings::{LinkHistory, Surroundings};
use crate::output::count;
use imrs_launch::cells::Loaded;
use imrs_model::cell::{CellFaults, Late};
use imrs_protocol::{NodeId, TaskId};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// The kind of a breach: an event of the run that the checks assume not to happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A packet never arrived.
    Loss,
    /// A packet arrived more than once.
    Dup,
    /// A packet took longer than its links allow.
    Delay,
    /// Clocks ran at different rates.
    Drift,
    /// A task acted more than a tick after its deadline.
    Late,
    /// An action failed.
    Fail,
    /// A node crashed.
    Crash,
    /// Several faults happened in one run that the cell declares only for different runs.
    Together,
}

/// A breach of an assumption of the cell about links, clocks, nodes or actions.
#[derive(Debug, Serialize)]
pub struct Breach {
    /// The kind of the breach.
    pub kind: Kind,
    /// What happened in the run, and what the cell declares.
    pub what: String,
    /// How often the run broke the assumption.
    pub times: u64,
    /// When the breach first happened, in seconds since the first task began; 0 for clocks.
    pub first: f64,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, what, times, first } = self;
        match kind {
            Kind::Delay | Kind::Late => {
                write!(f, "{what} ({}, first at {first:.3} s)", count(*times, "time"))
            }
            Kind::Loss | Kind::Dup | Kind::Fail | Kind::Together => {
                write!(f, "{what} (first at {first:.3} s)")
            }
            Kind::Crash => write!(f, "{what} (at {first:.3} s)"),
            Kind::Drift => f.write_str(what),
        }
    }
}

/// The assumptions of the cell, and the start of the run that is compared with them.
pub struct Assumed<'a> {
    /// The cell whose assumptions are judged.
    pub loaded: &'a Loaded,
    /// The fault hypotheses that the cell declares. A run may have the faults of only one of them.
    pub faults: &'a [CellFaults],
    /// The length of a tick in microseconds.
    pub tick: u64,
    /// When the run started, in microseconds of the clock that all nodes share.
    pub start: u64,
}

/// The faults of one kind in a run.
struct Had {
    kind: Kind,
    /// The event, in the singular: `packet never arrived`.
    one: &'static str,
    many: &'static str,
    /// The word of the cell language for this kind of fault.
    word: &'static str,
    times: u64,
    first: u64,
    /// How many faults of this kind a hypothesis allows.
    allows: fn(&CellFaults) -> u8,
}

impl Assumed<'_> {
    /// All breaches of assumptions in the run; `late` has the acts of tasks that acted late.
    pub fn breaches(&self, around: &Surroundings, late: &[Late]) -> Vec<Breach> {
        let mut all = self.counted(around);
        all.extend(self.crashes(around));
        all.extend(around.links.iter().filter_map(|(ends, link)| self.slow(*ends, link)));
        all.extend(self.drifts(around));
        all.extend(self.late(late));
        all
    }

    fn node(&self, node: NodeId) -> &str {
        &self.loaded.table.cell().nodes[node.index()].name
    }

    fn since(&self, at: u64) -> f64 {
        at.saturating_sub(self.start) as f64 / 1e6
    }

    /// The breaches of faults that a cell declares by their number.
    fn counted(&self, around: &Surroundings) -> Vec<Breach> {
        let all = |of: fn(&LinkHistory) -> &Vec<u64>| {
            let times: Vec<u64> = around.links.values().flat_map(of).copied().collect();
            (times.len() as u64, times.iter().min().copied().unwrap_or(0))
        };
        let (lost, copied) = (all(|link| &link.lost), all(|link| &link.copies));
        let failed = (around.failed.len() as u64, around.failed.iter().min().copied().unwrap_or(0));
        let had = |kind, (one, many), word, (times, first), allows| Had {
            kind,
            one,
            many,
            word,
            times,
            first,
            allows,
        };
        let all = [
            had(Kind::Loss, ("packet never arrived", "packets never arrived"), "loss", lost, |f| f.loss),
            had(Kind::Dup, ("packet arrived twice", "packets arrived twice"), "dup", copied, |f| f.dup),
            had(Kind::Fail, ("action failed", "actions failed"), "fail", failed, |f| f.fail),
        ];
        let mut breaches: Vec<Breach> = all.iter().filter_map(|had| self.too_many(had)).collect();
        let fits = |faults: &CellFaults| all.iter().all(|had| had.times <= u64::from((had.allows)(faults)));
        if breaches.is_empty() && all.iter().any(|had| had.times > 0) && !self.faults.iter().any(fits) {
            let had: Vec<String> = all.iter().filter(|had| had.times > 0).map(Had::text).collect();
            breaches.push(Breach {
                kind: Kind::Together,
                what: format!("{}; no `faults` of the cell declares them together", had.join(" and ")),
                times: 1,
                first: self
                    .since(all.iter().filter(|had| had.times > 0).map(|had| had.first).min().unwrap_or(0)),
            });
        }
        breaches
    }

    fn too_many(&self, had: &Had) -> Option<Breach> {
        let allowed = self.faults.iter().map(|faults| (had.allows)(faults)).max().unwrap_or(0);
        if had.times <= u64::from(allowed) {
            return None;
        }
        let declared = match allowed {
            0 => format!("no `{}`", had.word),
            some => format!("`{} {some}`", had.word),
        };
        let what = format!("{}, the cell declares {declared}", had.text());
        Some(Breach { kind: had.kind, what, times: had.times, first: self.since(had.first) })
    }

    /// The breaches by nodes whose recordings have no end although no fault hypothesis lets these nodes crash.
    fn crashes(&self, around: &Surroundings) -> Vec<Breach> {
        let declared = |node: &NodeId| self.faults.iter().any(|faults| faults.crash.contains(node));
        let ended = around.ended.iter().filter(|(node, _)| !declared(node));
        let breach = |(node, at): &(NodeId, u64)| {
            let node = self.node(*node);
            let what = format!(
                "node {node} was killed, or its recording was cut off; the cell declares no `crash` of it"
            );
            Breach { kind: Kind::Crash, what, times: 1, first: self.since(*at) }
        };
        ended.map(breach).collect()
    }

    /// The breach by packets that took longer than the bound of their route.
    fn slow(&self, (from, to): (NodeId, NodeId), link: &LinkHistory) -> Option<Breach> {
        let (first, _) = link.slow.first()?;
        let most = link.slow.iter().map(|(_, took)| *took).max()?;
        let (from, to, bound) = (self.node(from), self.node(to), msec(link.bound));
        let what = format!("link {from}--{to} took {:.1} ms, bound {bound} ms", msec(most));
        Some(Breach { kind: Kind::Delay, what, times: link.slow.len() as u64, first: self.since(*first) })
    }

    /// The breaches by clocks that drifted apart by more ticks than declared.
    fn drifts(&self, around: &Surroundings) -> Vec<Breach> {
        let allowed = self.faults.iter().map(|faults| u64::from(faults.drift)).max().unwrap_or(0);
        let too_far = around.drift.iter().filter(|(.., apart)| apart / self.tick > allowed);
        let breach = |(a, b, apart): &(NodeId, NodeId, u64)| {
            let declared = if allowed == 0 { "no `drift`".into() } else { format!("`drift {allowed}`") };
            let (a, b, apart) = (self.node(*a), self.node(*b), msec(*apart));
            let what = format!(
                "the clocks of {a} and {b} ran apart by at least {apart:.1} ms, the cell declares {declared}"
            );
            Breach { kind: Kind::Drift, what, times: 1, first: 0.0 }
        };
        too_far.map(breach).collect()
    }

    /// The breaches by tasks that acted late, by task and line.
    fn late(&self, late: &[Late]) -> Vec<Breach> {
        // For each task and line: the greatest lateness, the number of late acts, and the time of the first late act.
        let mut places: BTreeMap<(TaskId, Option<usize>), (u64, u64, u64)> = BTreeMap::new();
        for one in late {
            let line = self.loaded.line(one.task, one.address);
            let all = places.entry((one.task, line)).or_insert((0, 0, one.at));
            *all = (all.0.max(one.ticks), all.1 + 1, all.2);
        }
        let breach = |((task, line), (most, times, first)): ((TaskId, Option<usize>), (u64, u64, u64))| {
            let line = line.map(|line| format!(" line {line}")).unwrap_or_default();
            let name = &self.loaded.table.cell().tasks[task.index()].name;
            let what = format!("{name}{line} acted up to {} late", count(most, "tick"));
            Breach { kind: Kind::Late, what, times, first: self.since(first) }
        };
        places.into_iter().map(breach).collect()
    }
}

impl Had {
    fn text(&self) -> String {
        format!("{} {}", self.times, if self.times == 1 { self.one } else { self.many })
    }
}

fn msec(us: u64) -> f64 {
    us as f64 / 1e3
}
