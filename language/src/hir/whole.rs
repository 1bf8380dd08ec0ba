//! What is said of the cell as a whole: process classes, faults, checks.

use super::{Duration, Expr};
use crate::span::Span;
use imrs_protocol::{NodeId, PortId, TaskId};

/// A process class (D24).
#[derive(Clone, Debug)]
pub struct Couple {
    /// Which.
    pub kind: CoupleKind,
    /// Where it stands.
    pub span: Span,
}

/// The process classes of Table 1.
#[derive(Clone, Debug)]
pub enum CoupleKind {
    /// They share what a task administers.
    Loose {
        /// Who shares.
        tasks: Vec<TaskId>,
        /// The administrator.
        over: TaskId,
    },
    /// They act together.
    Tight(Vec<TaskId>),
    /// One after the other.
    Serial(TaskId, TaskId),
    /// One takes over from the other (D61).
    Work {
        /// Who acts first.
        primary: TaskId,
        /// Who takes over.
        standby: TaskId,
        /// Whether they exchange roles then.
        mutual: bool,
        /// The lease.
        lease: Duration,
        /// The take-over.
        takeover: Duration,
        /// The period of the beats.
        every: Duration,
        /// Their port.
        via: PortId,
    },
}

/// A hypothesis of what may go wrong, and how often: of several each one is looked at by itself.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// Lost packets.
    pub loss: u8,
    /// Packets that arrive twice.
    pub dup: u8,
    /// Actions that fail.
    pub fail: u8,
    /// Ticks that a clock leaves out or counts twice.
    pub drift: u8,
    /// Nodes that crash, one entry for each crash.
    pub crash: Vec<NodeId>,
    /// Nodes that pause, one entry for each pause, and for how long at most; none: see [`Pause::most`].
    pub pause: Vec<Pause>,
    /// Links that are cut for a while, one entry for each cut: positions in [`Hir::links`](super::Hir).
    pub cut: Vec<usize>,
    /// Where the declaration stands.
    pub span: Span,
}

/// A pause of a node: for a while it takes no step, as when its process is stopped (SIGSTOP) or gets no processor.
#[derive(Clone, Copy, Debug)]
pub struct Pause {
    /// Which node.
    pub node: NodeId,
    /// How long it lasts at most. None: until every time_out and take-over of the cell that began before it is over.
    pub most: Option<Duration>,
}

/// What must hold.
#[derive(Clone, Debug)]
pub struct Check {
    /// Its name.
    pub name: String,
    /// What must hold.
    pub kind: CheckKind,
    /// Where its name stands.
    pub span: Span,
}

/// What must hold. The expressions are those of the script machine, with `Term::Of` and `Term::Is` (D45).
#[derive(Clone, Debug)]
pub enum CheckKind {
    /// In every state.
    Always(Expr),
    /// In no state.
    Never(Expr),
    /// Whenever one is true, the other is, then or within so much time.
    Leads {
        /// The one.
        when: Expr,
        /// The other.
        then: Expr,
        /// How long.
        within: Duration,
    },
}
