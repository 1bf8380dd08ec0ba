//! Declarations about the cell as a whole: process classes, faults and checks.

use super::{Duration, Expr};
use crate::span::Span;
use imrs_protocol::{NodeId, PortId, TaskId};

/// A process class (D24).
#[derive(Clone, Debug)]
pub struct Couple {
    /// The class, with the tasks of the couple.
    pub kind: CoupleKind,
    /// The declaration's span.
    pub span: Span,
}

/// The process classes of Table 1.
#[derive(Clone, Debug)]
pub enum CoupleKind {
    /// Tasks that share something, which another task administers for them.
    Loose {
        /// The tasks that share something, such as a tool.
        tasks: Vec<TaskId>,
        /// The task that administers what the other tasks share.
        over: TaskId,
    },
    /// Tasks that act together.
    Tight(Vec<TaskId>),
    /// Two tasks that act one after the other.
    Serial(TaskId, TaskId),
    /// A standby that takes over from a primary (D61).
    Work {
        /// The task that acts first.
        primary: TaskId,
        /// The task that takes over.
        standby: TaskId,
        /// Whether primary and standby swap roles at a take-over.
        mutual: bool,
        /// How long the primary may act after it sent an answer that the standby echoes.
        lease: Duration,
        /// How long after the last answer from the primary the standby takes over.
        takeover: Duration,
        /// The period of the heartbeats.
        every: Duration,
        /// The port of the heartbeats.
        via: PortId,
    },
}

/// A link.
#[derive(Clone, Debug)]
pub struct Link {
    /// The node at one end.
    pub a: NodeId,
    /// The node at the other end.
    pub b: NodeId,
    /// The longest delay of a packet that is not lost (D20).
    pub delay: Duration,
    /// The most packets that the link carries in each period of this length, if the cell declares it.
    pub capacity: Option<(u16, Duration)>,
    /// The link's span.
    pub span: Span,
}

/// A fault hypothesis: what may go wrong, and how often. The checker tries each hypothesis on its own.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// The number of packets that are lost.
    pub loss: u8,
    /// The number of packets that arrive twice.
    pub dup: u8,
    /// The number of actions that fail.
    pub fail: u8,
    /// The number of ticks that a clock leaves out or counts twice.
    pub drift: u8,
    /// Nodes that crash, one entry for each crash.
    pub crash: Vec<NodeId>,
    /// Nodes that pause, one entry for each pause.
    pub pause: Vec<Pause>,
    /// Links that are cut for a while, one entry for each cut: positions in [`Hir::links`](super::Hir).
    pub cut: Vec<usize>,
    /// The span of the declaration.
    pub span: Span,
}

/// A pause of a node: for a while it takes no step, as when its process is stopped (SIGSTOP) or gets no processor.
#[derive(Clone, Copy, Debug)]
pub struct Pause {
    /// The paused node.
    pub node: NodeId,
    /// The pause's longest duration. `None`: the pause lasts until every time_out and take-over that began before it
    /// has passed.
    pub most: Option<Duration>,
}

/// A property to check.
#[derive(Clone, Debug)]
pub struct Check {
    /// The property's name.
    pub name: String,
    /// The property's kind and its expressions.
    pub kind: CheckKind,
    /// The span of the check's name.
    pub span: Span,
}

/// A kind of property. The expressions are those of scripts, with `Term::Of` and `Term::Is` (D45).
#[derive(Clone, Debug)]
pub enum CheckKind {
    /// The expression is true in every state.
    Always(Expr),
    /// The expression is true in no state.
    Never(Expr),
    /// Whenever `when` is true, `then` is true at the same time or within `within`.
    Leads {
        /// The premise of the property.
        when: Expr,
        /// The consequence, which must become true in time.
        then: Expr,
        /// The longest time from the premise to the consequence.
        within: Duration,
    },
}
