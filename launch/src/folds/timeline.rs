//! The lines of a run for people: in the order of time, and no faster than they can be read.

use super::links::{Alarm, SecuritySummary, fault_words, security_words};
use crate::cells::Loaded;
use crate::fact::{Fact, Fold};
use crate::faults::Fault;
use crate::pipe::{Figures, Word};
use crate::script_event::Did;
use crate::words::span;
use imrs_protocol::{NodeId, TaskId};
use imrs_runtime::link::udp::WINDOW;
use std::collections::{BTreeMap, BTreeSet};

/// An event is shown when it is this old, in microseconds. Nodes report events every few milliseconds, so by then no
/// node can still report an earlier event.
const SETTLED: u64 = 100_000;
/// How many lines of one task are shown within one interval of `SPAN`, at most.
const PER_SPAN: u32 = 20;
/// The length of the interval for [`PER_SPAN`], in microseconds.
const SPAN: u64 = 1_000_000;

/// Collects the lines of a run until they can be shown.
pub struct Timeline<'a> {
    loaded: &'a Loaded,
    /// Whether the nodes share this process.
    in_process: bool,
    /// When the run began, in microseconds of the clock that all processes of one machine share.
    began: u64,
    /// Lines by time; lines of the same time in the order in which they were reported.
    waiting: BTreeMap<(u64, u64), Entry>,
    told: u64,
    /// For each task, the span of time in which its last line was shown, and how many of its lines were shown
    /// in that span.
    paces: Vec<(u64, u32)>,
    /// Refusals between neighbours that a line has already reported.
    refused: BTreeSet<String>,
    /// For each link that was faulty, by receiver and sender, how often a line has reported it.
    faults: BTreeMap<(NodeId, NodeId), u64>,
    /// The neighbours that had stopped by the last report of a node, by node.
    stopped: BTreeSet<(NodeId, NodeId)>,
    /// For each node, whether too many datagrams came that no node of the cell sent.
    alarms: Vec<Alarm>,
    /// Whether this launcher runs one node of several.
    is_alone: bool,
    /// How many datagrams of ended sessions a node had dropped when a line last reported this, and when that line was
    /// added.
    ended: (u64, u64),
}

/// A line that is not shown yet.
enum Entry {
    Did(Did),
    Fault(String),
    Broken(String),
    Idle(String),
}

/// A line of a run, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// The time of the line, in microseconds since the run began.
    pub at: u64,
    /// The content of the line.
    pub what: Telling,
}

/// The content of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Telling {
    /// An act of a script.
    Did {
        /// The script's task.
        task: TaskId,
        /// The line of the statement in the cell file.
        line: Option<usize>,
        /// How many lines of the task were left out before this one.
        left_out: u32,
        /// The act of the script, in words.
        words: String,
    },
    /// A text about a fault or the nodes. There are few of these.
    Fault(String),
    /// A text that says that a check does not hold, or that nodes refuse each other. There are few of these.
    Broken(String),
    /// A text that says that the only tasks that still run serve for ever. A run shows it once.
    Idle(String),
}

impl Fold for Timeline<'_> {
    fn take(&mut self, at: u64, fact: &Fact) {
        match fact {
            Fact::Began => self.began = at,
            Fact::Said(_, Word::Did(did)) => self.add(did.at, Entry::Did(did.clone())),
            Fact::Said(node, Word::Figures(figures)) => {
                self.refusals(at, *node, figures);
                self.links(at, *node, figures);
                self.stops(at, *node, figures);
                self.ended_sessions(at, *node, figures);
            }
            Fact::Said(node, Word::HeldBack(held)) => self.held_back(at, *node, held),
            Fact::Fault(fault) => self.add(at, Entry::Fault(self.fault(*fault))),
            Fact::Broken(broken) => self.add(broken.at, Entry::Broken(broken.words(self.loaded))),
            Fact::Idle(left) => {
                let names: Vec<&str> = left.iter().map(|task| self.task(*task)).collect();
                self.add(at, Entry::Idle(format!("only servers are left: {}", names.join(", "))));
            }
            _ => {}
        }
    }
}

impl<'a> Timeline<'a> {
    /// Makes the timeline of a run, before any event.
    pub fn new(loaded: &'a Loaded, in_process: bool, is_alone: bool) -> Self {
        Self {
            loaded,
            in_process,
            began: 0,
            waiting: BTreeMap::new(),
            told: 0,
            paces: vec![(0, 0); loaded.table.cell().tasks.len()],
            refused: BTreeSet::new(),
            faults: BTreeMap::new(),
            stopped: BTreeSet::new(),
            alarms: vec![Alarm::default(); loaded.table.cell().nodes.len()],
            is_alone,
            ended: (0, 0),
        }
    }

    fn add(&mut self, at: u64, entry: Entry) {
        self.waiting.insert((at, self.told), entry);
        self.told += 1;
    }

    /// Whether no line is pending.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Takes all lines that are older than `SETTLED` at the instant `now`.
    pub fn settled(&mut self, now: u64) -> Vec<Line> {
        let later = self.waiting.split_off(&(now.saturating_sub(SETTLED), 0));
        let settled = std::mem::replace(&mut self.waiting, later);
        let mut lines = Vec::new();
        for ((at, _), entry) in settled {
            let what = match entry {
                Entry::Did(did) => {
                    let left_out = self.pace(&did);
                    if left_out.is_none() && !did.what.is_rare() {
                        continue;
                    }
                    let (task, line, words) = (did.task, did.line, did.what.words(&self.loaded.table));
                    Telling::Did { task, line, left_out: left_out.unwrap_or_default(), words }
                }
                Entry::Fault(words) => Telling::Fault(words),
                Entry::Broken(words) => Telling::Broken(words),
                Entry::Idle(words) => Telling::Idle(words),
            };
            lines.push(Line { at: at.saturating_sub(self.began), what });
        }
        lines
    }

    /// Decides whether the line of this event is shown. Returns how many lines were left out before it; `None` if this
    /// line is left out itself.
    fn pace(&mut self, did: &Did) -> Option<u32> {
        let span = did.at.saturating_sub(self.began) / SPAN;
        let pace = self.paces.get_mut(did.task.index())?;
        let left_out = if pace.0 == span { 0 } else { pace.1.saturating_sub(PER_SPAN) };
        *pace = if pace.0 == span { (span, pace.1 + 1) } else { (span, 1) };
        (pace.1 <= PER_SPAN).then_some(left_out)
    }

    fn name(&self, node: NodeId) -> &str {
        &self.loaded.table.cell().nodes[node.index()].name
    }

    fn task(&self, task: TaskId) -> &str {
        &self.loaded.table.cell().tasks[task.index()].name
    }

    fn fault(&self, fault: Fault) -> String {
        let name = |node| self.name(node);
        match fault {
            Fault::Kill(node) => format!("fault: node {} is killed", name(node)),
            Fault::Restart(node) => format!("node {} is started again", name(node)),
            Fault::Cut(a, b) => format!("fault: nothing passes between {} and {}", name(a), name(b)),
            Fault::Heal(a, b) => format!("{} and {} reach each other again", name(a), name(b)),
            Fault::Pause(node) if self.in_process => {
                format!("fault: nothing passes between {} and the others", name(node))
            }
            Fault::Pause(node) => format!("fault: node {} stands still", name(node)),
            Fault::Resume(node) if self.in_process => {
                format!("{} and the others reach each other again", name(node))
            }
            Fault::Resume(node) => format!("node {} goes on", name(node)),
        }
    }

    /// Adds a line for each neighbour that a node refuses, but only once.
    fn refusals(&mut self, at: u64, node: NodeId, figures: &Figures) {
        for refusal in &figures.refusals {
            let words = refusal.words(self.name(node));
            if self.refused.insert(words.clone()) {
                self.add(at, Entry::Broken(words));
            }
        }
    }

    /// Adds a line when a neighbour has said that it stopped.
    fn stops(&mut self, at: u64, node: NodeId, figures: &Figures) {
        for report in &figures.links {
            let ends = (node, report.peer);
            if !report.has_stopped {
                self.stopped.remove(&ends);
            } else if self.stopped.insert(ends) {
                let words = format!(
                    "node {} has stopped in order, it says to {}",
                    self.name(report.peer),
                    self.name(node)
                );
                self.add(at, Entry::Fault(words));
            }
        }
    }

    /// Adds a line each time that a link begins to count as faulty, and each time that an alarm about foreign datagrams
    /// is raised.
    fn links(&mut self, at: u64, node: NodeId, figures: &Figures) {
        for report in figures.links.iter().filter(|report| report.integrity.faults > 0) {
            let told = self.faults.insert((node, report.peer), report.integrity.faults);
            if told != Some(report.integrity.faults) {
                let words = fault_words(self.name(report.peer), self.name(node), &report.integrity);
                self.add(at, Entry::Broken(words));
            }
        }
        if self.alarms[node.index()].take(at, &figures.link_discards) {
            let words = security_words(self.name(node), &SecuritySummary::new(&figures.link_discards, 1));
            self.add(at, Entry::Broken(words));
        }
    }

    /// Adds a line when a node that runs alone drops datagrams of an ended session, but not again for a while. For a
    /// launcher of all nodes no line is needed: it has restarted the neighbour itself, and a line says so.
    fn ended_sessions(&mut self, at: u64, node: NodeId, figures: &Figures) {
        let dropped = figures.link_discards.get("stale_session").copied().unwrap_or_default();
        let (told, told_at) = self.ended;
        if self.is_alone && dropped > told && (told == 0 || at.saturating_sub(told_at) >= WINDOW) {
            self.ended = (dropped, at);
            let words = format!(
                "node {} has dropped datagrams of an ended session ({dropped} stale_session): a neighbour was started again, or somebody repeats old datagrams",
                self.name(node)
            );
            self.add(at, Entry::Fault(words));
        }
    }

    /// Adds a line for each script of a restarted node that does not begin yet. The line says when it will.
    fn held_back(&mut self, at: u64, node: NodeId, held: &[(TaskId, u64)]) {
        let all = self.loaded.table.tasks_on(node).count() == held.len();
        let mut by_time: BTreeMap<u64, Vec<&str>> = BTreeMap::new();
        for (task, time) in held {
            by_time.entry(*time).or_default().push(self.task(*task));
        }
        let of = |names: &[&str]| match names {
            _ if all && names.len() == held.len() => String::new(),
            [name] => format!("task {name} "),
            names => format!("tasks {} ", names.join(", ")),
        };
        let lines: Vec<String> = by_time
            .iter()
            .map(|(time, names)| {
                let (name, of, time) = (self.name(node), of(names), span(*time));
                format!("node {name}: {of}held back {time} more: commands of its earlier incarnation may still arrive")
            })
            .collect();
        lines.into_iter().for_each(|line| self.add(at, Entry::Fault(line)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::tests::beam_lift;
    use crate::script_event::ScriptEvent;

    fn did(at: u64, task: u16) -> Did {
        Did { at, task: TaskId(task), line: Some(3), what: ScriptEvent::CutShort(format!("{at}")) }
    }

    #[test]
    fn a_task_that_is_busy_is_shown_in_part_and_what_is_left_out_is_counted() {
        let loaded = beam_lift();
        let mut timeline = Timeline::new(&loaded, false, false);
        let shown = (0..50).filter(|at| timeline.pace(&did(*at, 0)).is_some()).count();
        assert_eq!(shown, usize::try_from(PER_SPAN).unwrap());
        assert_eq!(timeline.pace(&did(7, 1)), Some(0));
        assert_eq!(timeline.pace(&did(SPAN, 0)), Some(50 - PER_SPAN));
        assert_eq!(timeline.pace(&did(SPAN, 0)), Some(0));
    }

    #[test]
    fn lines_wait_until_nothing_earlier_can_come() {
        let loaded = beam_lift();
        let mut timeline = Timeline::new(&loaded, false, false);
        for did in [did(200_000, 0), did(100_000, 1)] {
            timeline.take(did.at, &Fact::Said(NodeId(0), Word::Did(did)));
        }
        let times = |lines: Vec<Line>| lines.iter().map(|line| line.at).collect::<Vec<_>>();
        assert_eq!(times(timeline.settled(200_050)), [100_000]);
        assert_eq!(times(timeline.settled(u64::MAX)), [200_000]);
        assert!(timeline.is_empty());
    }
}
