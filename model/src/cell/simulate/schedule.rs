//! A schedule as data: its faults one by one, and its choices.

use crate::cell::{CellFaults, Pause};
use imrs_protocol::{CellTable, NodeId, TaskId};
use std::collections::BTreeMap;

/// A fault of a schedule. Packets and actions are counted from 1, in the order in which they arrive or end; instants are in
/// ticks from the start. A fault waits for the first moment at which the checker allows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// This packet of a link, in this direction, is lost.
    Lose {
        /// The link, by its direction: from the first node to the second.
        link: (NodeId, NodeId),
        /// The number of the packet on its link.
        nth: u32,
    },
    /// This packet arrives twice; its copy counts as the next packet.
    Copy {
        /// The link, by its direction: from the first node to the second.
        link: (NodeId, NodeId),
        /// The number of the packet on its link.
        nth: u32,
    },
    /// A packet is overtaken by the packet behind it: this packet, or the first later one on the link that has another
    /// packet behind it.
    Overtake {
        /// The link, by its direction: from the first node to the second.
        link: (NodeId, NodeId),
        /// The number of the packet on its link.
        nth: u32,
    },
    /// This action of a task fails.
    Fail {
        /// The task whose action fails.
        task: TaskId,
        /// The number of the action among all actions of the task.
        nth: u32,
    },
    /// A node crashes right after one of its steps.
    Stop {
        /// The node that crashes.
        node: NodeId,
        /// The crash does not happen before this instant.
        at: u64,
        /// Ticks until the node may restart. The node then restarts when the next packet arrives for it, or when nothing
        /// else happens. `None`: the node stays down.
        restart: Option<u64>,
    },
    /// A link loses all packets, in both directions.
    Cut {
        /// The position of the link in [`Cell::links`](imrs_protocol::Cell).
        link: usize,
        /// The cut begins with the first packet at or after this instant.
        at: u64,
        /// Ticks until the cut ends. `None`: it never ends.
        lasts: Option<u64>,
    },
    /// A node pauses before its next step.
    Pause {
        /// The node that pauses.
        node: NodeId,
        /// The pause does not begin before this instant.
        at: u64,
        /// How many ticks the pause lasts.
        lasts: u32,
        /// Whether the node pauses right after it began an action, which then begins only when the node wakes.
        before_action: bool,
    },
    /// A node's clock counts a tick twice, or leaves one out.
    Drift {
        /// The node whose clock drifts.
        node: NodeId,
        /// The drift does not happen before this instant.
        at: u64,
        /// Whether the node's clock counts one tick twice. If not, it leaves one tick out.
        more: bool,
    },
}

/// The chooser to which a choice belongs. Each chooser has its own list of choices, so that leaving out a fault does not
/// change the choices of the other choosers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Chooser {
    /// A task: how long its actions take, which results they give, and what its script chooses.
    Task(TaskId),
    /// A directed link, from the first node to the second: how early its packets arrive.
    Link(NodeId, NodeId),
    /// A node: which of several events in one tick comes first.
    Node(NodeId),
}

/// The choices of a run, each below the number of alternatives at that point. Choices past the end of a list are 0: an
/// action takes its least time and gives its first value, a packet takes its link's bound.
pub type Tape = BTreeMap<Chooser, Vec<u32>>;

/// One run of a cell. The same schedule and the same cell give the same run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schedule {
    /// The faults of the run.
    pub faults: Vec<Fault>,
    /// The choices of the run.
    pub tape: Tape,
}

impl Schedule {
    /// How many choices are not 0.
    #[must_use]
    pub fn choices(&self) -> usize {
        self.tape.values().flatten().filter(|&&choice| choice != 0).count()
    }
}

/// The instant of a fault; 0 for a fault without an instant.
const fn instant(fault: &Fault) -> u64 {
    match *fault {
        Fault::Stop { at, .. }
        | Fault::Cut { at, .. }
        | Fault::Pause { at, .. }
        | Fault::Drift { at, .. } => at,
        Fault::Lose { .. } | Fault::Copy { .. } | Fault::Overtake { .. } | Fault::Fail { .. } => 0,
    }
}

/// Faults in the order in which the budgets of a cell number them.
pub(super) fn in_order(faults: &[Fault]) -> Vec<Fault> {
    let mut faults = faults.to_vec();
    faults.sort_by_key(instant);
    faults
}

/// The faults of the schedule that did not happen.
pub(super) fn idle(faults: &[Fault], happened: &[bool]) -> Vec<Fault> {
    let all = in_order(faults).into_iter().zip(happened);
    all.filter(|(_, happened)| !**happened).map(|(fault, _)| fault).collect()
}

/// The budgets that allow exactly these faults. Faults that have an instant must be sorted by this instant.
pub(super) fn budgets(faults: &[Fault]) -> CellFaults {
    let mut all = CellFaults::default();
    for fault in faults {
        match *fault {
            Fault::Lose { .. } => all.loss = all.loss.saturating_add(1),
            Fault::Copy { .. } => all.dup = all.dup.saturating_add(1),
            Fault::Overtake { .. } => all.reorder = all.reorder.saturating_add(1),
            Fault::Fail { .. } => all.fail = all.fail.saturating_add(1),
            Fault::Drift { .. } => all.drift = all.drift.saturating_add(1),
            Fault::Stop { node, .. } => all.crash.push(node),
            Fault::Cut { link, .. } => all.cut.push(link),
            Fault::Pause { node, lasts, .. } => all.pause.push(Pause { node: Some(node), most: lasts }),
        }
    }
    all
}

/// The greatest number of faults of a schedule: a byte counts them.
pub const MOST_FAULTS: usize = 255;

impl Fault {
    /// Describes the fault in the names of the cell. `time` formats a number of ticks.
    #[must_use]
    pub fn words(&self, table: &CellTable, time: &dyn Fn(u64) -> String) -> String {
        let cell = table.cell();
        let name = |node: NodeId| cell.nodes.get(node.index()).map_or("?", |node| node.name.as_str());
        let on = |(from, to): (NodeId, NodeId)| format!("{} -> {}", name(from), name(to));
        match *self {
            Self::Lose { link, nth } => format!("packet {nth} of {} is lost", on(link)),
            Self::Copy { link, nth } => format!("packet {nth} of {} arrives twice", on(link)),
            Self::Overtake { link, nth } => format!("packet {nth} of {} is overtaken", on(link)),
            Self::Fail { task, nth } => {
                let task = cell.tasks.get(task.index()).map_or("?", |task| task.name.as_str());
                format!("action {nth} of {task} fails")
            }
            Self::Stop { node, at, restart } => {
                let then = match restart {
                    None => "stays down".into(),
                    Some(0) => "starts again at once".into(),
                    Some(after) => format!("starts again {} later", time(after)),
                };
                format!("{} stops at {} and {then}", name(node), time(at))
            }
            Self::Cut { link, at, lasts } => {
                let ends = cell.links.get(link).map_or(("?", "?"), |link| (name(link.a), name(link.b)));
                let lasts = lasts.map_or_else(|| "to the end".into(), |lasts| format!("for {}", time(lasts)));
                format!("the link {} -- {} is cut at {} {lasts}", ends.0, ends.1, time(at))
            }
            Self::Pause { node, at, lasts, before_action } => {
                let action = if before_action { ", before an action that it begins" } else { "" };
                format!("{} pauses at {} for {}{action}", name(node), time(at), time(lasts.into()))
            }
            Self::Drift { node, at, more } => {
                let what = if more { "counts a tick twice" } else { "misses a tick" };
                format!("{} {what} at {}", name(node), time(at))
            }
        }
    }
}
