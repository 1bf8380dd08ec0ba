//! Scenarios to explore: a cell, what its tasks do, links, fault budgets, and the properties that are checked.

use imrs_protocol::script::{Predicate, Program, Term};
use imrs_protocol::{CellTable, NodeId, NodeTable, PortId, ServiceOrder, Target, TaskId, Ticks};
use std::sync::Arc;

/// How often a task does something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// At most this often.
    Most(u8),
    /// Without a limit.
    Endless,
}

/// What the thread of a task does whenever it is idle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errand {
    /// The thread does nothing: it never makes an API call.
    Rest,
    /// The thread sends messages or queries.
    Send {
        /// The port on which the task sends.
        port: PortId,
        /// The receivers of each message.
        to: Target,
        /// How often the task sends.
        times: Times,
        /// The least number of ticks between two sends.
        every: u8,
    },
    /// The thread sends status messages under its lease, while it is active (D61).
    Order {
        /// The port on which the task sends orders.
        port: PortId,
        /// How often the task sends.
        times: Times,
    },
    /// The thread receives messages, and serves each for the ticks of [`TaskPlan::service`].
    Receive {
        /// The port; `None` takes the most urgent message of all ports.
        port: Option<PortId>,
        /// How long the thread waits for a message; `None` waits without a limit.
        time_out: Option<Ticks>,
    },
    /// The thread runs an action, which handlers may interrupt.
    Work {
        /// The least number of ticks of an action.
        least: u8,
        /// The greatest number of ticks of an action.
        most: u8,
        /// How often the task runs an action.
        times: Times,
    },
    /// The thread reaches a waitfor.
    Meet {
        /// The port of the waitfor.
        port: PortId,
        /// How often the task reaches the waitfor.
        times: Times,
    },
    /// The thread delays.
    Delay {
        /// The length of a delay.
        length: Ticks,
        /// How often the task delays.
        times: Times,
    },
}

/// What a task of the cell does.
#[derive(Clone, Debug)]
pub struct TaskPlan {
    /// What the task's thread does when it is idle.
    pub errand: Errand,
    /// The ports for which the task has handlers.
    pub handles: Vec<PortId>,
    /// The task's `order` of service.
    pub order: ServiceOrder,
    /// For how many ticks, at least and at most, the task or its handler serves a message before answering it.
    pub service: (u8, u8),
    /// A port on which a handler may send a command before it answers.
    pub nested: Option<PortId>,
    /// Whether the task is eager: its thread begins the next errand at once, and not at any time later.
    pub hurry: bool,
    /// The program that the task runs instead of an errand.
    pub script: Option<Arc<Program>>,
}

impl TaskPlan {
    /// A task with this errand and no handlers. The task may act and answer at any time.
    #[must_use]
    pub fn new(errand: Errand) -> Self {
        let order = ServiceOrder::default();
        Self {
            errand,
            handles: Vec::new(),
            order,
            service: (0, u8::MAX),
            nested: None,
            hurry: false,
            script: None,
        }
    }

    /// A task that runs a program. The properties judge by `order`, so the program must set the same order.
    #[must_use]
    pub fn scripted(program: Arc<Program>) -> Self {
        Self { script: Some(program), ..Self::new(Errand::Rest) }
    }

    /// The same task, but eager.
    #[must_use]
    pub fn hurried(self) -> Self {
        Self { hurry: true, ..self }
    }

    /// The same task, which serves each message for `least` to `most` ticks.
    #[must_use]
    pub fn serving(self, least: u8, most: u8) -> Self {
        Self { service: (least, most), ..self }
    }

    /// The same task, with handlers for these ports.
    #[must_use]
    pub fn handling(self, ports: &[PortId]) -> Self {
        Self { handles: ports.to_vec(), ..self }
    }

    /// The same task with this `order` of service.
    #[must_use]
    pub fn ordered(self, order: ServiceOrder) -> Self {
        Self { order, ..self }
    }

    /// The same task, whose handlers may send a command on this port before they answer.
    #[must_use]
    pub fn nesting(self, port: PortId) -> Self {
        Self { nested: Some(port), ..self }
    }
}

/// The greatest number of faults of each kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The number of packets that are lost; [`u8::MAX`] stands for any number.
    pub loss: u8,
    /// The number of packets that are duplicated.
    pub dup: u8,
    /// The number of crashes. A crashed node may restart in its next incarnation.
    pub crash: u8,
    /// The number of ticks that some node's clock leaves out or counts twice.
    pub drift: u8,
    /// The number of ticks that a node notices only at the next tick or at its next input.
    pub late: u8,
    /// The number of packets that are charged one tick more than their link's bound (D20).
    pub over: u8,
}

/// How packets cross a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Packets take any time up to the link's bound, and may overtake each other.
    Any,
    /// Packets take exactly the link's bound, and arrive in the order in which they left.
    Exact,
}

/// A property that is checked. A scenario may check several; the first violation ends the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellProperty {
    /// No message is handed over more than `slack` ticks after its sender's time_out.
    Stale {
        /// Ticks that drifting clocks may add.
        slack: u8,
    },
    /// No queued message has more time left than its sender still waits.
    TimeToLive,
    /// No message stays queued after its sender's time_out.
    Expires,
    /// Every wait ends within its time_out, one tick and `slack`; every request gets one outcome, the right one.
    Waits {
        /// Ticks that late and drifting clocks may add.
        slack: u8,
    },
    /// No message is handed over twice.
    AtMostOnce,
    /// A command whose sender is told that it was refused, or never sent, has not run and does not run later.
    DidNotRun,
    /// A handler runs only if it outranks the activation that it interrupts.
    Order,
    /// At one task, a port is bypassed, and a message is rejected, at most this often.
    Fair {
        /// The task that is watched.
        task: TaskId,
        /// The greatest number of bypasses of a port by GETs over all ports.
        bypasses: u8,
        /// The greatest number of rejections of one message.
        refusals: u8,
    },
    /// No message of this port is dropped, and no wait on it ends by its time_out.
    Served {
        /// The port that is watched.
        port: PortId,
    },
    /// No command that can still arrive is dropped for space while the same transit buffer holds a status message (D60).
    Eviction,
    /// Between two ticks every task gets at most `signals` signals.
    Zeno {
        /// The greatest number of signals between two ticks.
        signals: u8,
    },
    /// Of the tasks of a couple at most one is active (D61).
    OneActive,
    /// A task that has received an order of one epoch executes no order of an older epoch (D61). Orders carry an epoch.
    FencedOrders,
    /// The search must reach this goal, as a counterexample to "never"; otherwise the other properties hold vacuously.
    Reach(Goal),
}

/// An event that the search must reach: see [`CellProperty::Reach`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// A handler interrupts a handler.
    Nested,
    /// The source of a command learns that a relay refused it.
    RefusedOnTheWay,
    /// A task learns that its command was refused.
    Refused,
    /// A task learns that its command was never sent.
    Unsent,
    /// A command is answered.
    Answered,
    /// A query to several tasks ends with an answer of each.
    AllAnswered,
    /// The nodes at both ends of a link wait for space in the buffer of the other node.
    BuffersFull,
    /// The second task of the couple is active, because it took over.
    TookOver,
    /// A lease ends.
    Fenced,
    /// A message that waited leaves its buffer, whether it is handed over or dropped.
    Left,
}

/// Everything that a search needs to explore a cell.
#[derive(Clone, Debug)]
pub struct CellScenario {
    /// The cell's table.
    pub cell: Arc<CellTable>,
    /// What each task does, by task.
    pub tasks: Vec<TaskPlan>,
    /// How many packets a node's transit buffer holds.
    pub transit: u16,
    /// How many packets each direction of a link takes in one tick; `None`: any number.
    pub room: Option<u8>,
    /// Whether a link takes a packet only if the next node's transit buffer has space for it.
    pub pressure: bool,
    /// How packets cross links.
    pub transfer: Transfer,
    /// The faults that may happen.
    pub faults: Faults,
    /// The properties that are checked.
    pub watches: Vec<CellProperty>,
    /// Expressions over the tasks' scripts that must be true in every state.
    pub checks: Vec<Vec<Term>>,
    /// Whether a transition includes its effects within its node and the next step of an eager task.
    pub fused: bool,
    /// Whether states keep the dedup entries of messages of which no copy can arrive any more.
    pub keeps_seen: bool,
    /// Whether the cell state is followed from its start and never loaded, so that its history is judged, too.
    pub(crate) history: bool,
    /// Whether the search skips over ticks in which nothing happens and nothing else is enabled.
    pub jumps: bool,
    /// For each node, how many ticks its clock is ahead.
    pub clocks: Vec<u64>,
    /// The first epoch of couples and actuators (even). A restarted node begins with the state machine's own epoch.
    pub epoch: u8,
    /// A mask of the nodes that are left out: they are down for ever, and neither they nor their tasks are packed.
    pub(crate) left_out: u64,
}

impl CellScenario {
    /// A plan without faults and without limits on its links.
    #[must_use]
    pub fn new(cell: Arc<CellTable>, tasks: Vec<TaskPlan>) -> Self {
        let clocks = vec![0; cell.cell().nodes.len()];
        Self {
            cell,
            tasks,
            transit: 4,
            room: None,
            pressure: false,
            transfer: Transfer::Any,
            faults: Faults::default(),
            watches: Vec::new(),
            checks: Vec::new(),
            fused: true,
            keeps_seen: true,
            history: false,
            jumps: true,
            clocks,
            epoch: 0,
            left_out: 0,
        }
    }

    /// Adds a property to be checked.
    #[must_use]
    pub fn watching(mut self, watch: CellProperty) -> Self {
        self.watches.push(watch);
        self
    }

    /// The table of the cell as `node` sees it.
    #[must_use]
    pub fn table(&self, node: NodeId) -> NodeTable {
        NodeTable::new(Arc::clone(&self.cell), node)
    }

    /// The number of nodes of the cell.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.cell.cell().nodes.len()
    }

    /// Whether the search leaves out a node.
    pub(crate) const fn leaves_out(&self, node: usize) -> bool {
        self.left_out != 0 && node < 64 && self.left_out >> node & 1 == 1
    }

    /// Whether a task is on a node that the search leaves out.
    pub(crate) fn leaves_out_task(&self, task: TaskId) -> bool {
        self.left_out != 0 && self.leaves_out(self.cell.location(task).map_or(0, NodeId::index))
    }

    /// The name of a task.
    #[must_use]
    pub fn name(&self, task: TaskId) -> &str {
        self.cell.cell().tasks.get(task.index()).map_or("?", |t| &t.name)
    }

    /// Whether nodes can have more than one incarnation.
    #[must_use]
    pub const fn incarnations(&self) -> bool {
        self.faults.crash > 0
    }

    /// The directed links: from, to, bound.
    #[must_use]
    pub fn links(&self) -> Vec<(NodeId, NodeId, u8)> {
        let both = self.cell.cell().links.iter().flat_map(|l| {
            let bound = u8::try_from(l.delay.0).unwrap_or(u8::MAX);
            [(l.a, l.b, bound), (l.b, l.a, bound)]
        });
        both.collect()
    }

    pub(crate) fn stale(&self) -> Option<u8> {
        self.watches
            .iter()
            .find_map(|w| if let CellProperty::Stale { slack } = *w { Some(slack) } else { None })
    }

    /// By how many ticks the true remaining times of messages exceed the declared ones. `None`: they are not kept.
    pub(crate) fn times_messages(&self) -> Option<u8> {
        let held = [CellProperty::TimeToLive, CellProperty::Expires];
        self.stale().or_else(|| held.into_iter().any(|watch| self.watches(watch)).then_some(0))
    }

    pub(crate) fn waits(&self) -> Option<u8> {
        self.watches
            .iter()
            .find_map(|w| if let CellProperty::Waits { slack } = *w { Some(slack) } else { None })
    }

    pub(crate) fn fair(&self) -> Option<(TaskId, u8, u8)> {
        self.watches.iter().find_map(|w| match *w {
            CellProperty::Fair { task, bypasses, refusals } => Some((task, bypasses, refusals)),
            _ => None,
        })
    }

    pub(crate) fn zeno(&self) -> Option<u8> {
        self.watches
            .iter()
            .find_map(|w| if let CellProperty::Zeno { signals } = w { Some(*signals) } else { None })
    }

    pub(crate) fn watches(&self, watch: CellProperty) -> bool {
        self.watches.contains(&watch)
    }

    /// Whether rejections must be counted.
    pub(crate) fn counts_refusals(&self) -> bool {
        self.fair().is_some() || self.watches(CellProperty::Order)
    }

    /// The predicates that the plan's checks read.
    pub(crate) fn predicates(&self) -> impl Iterator<Item = Predicate> {
        self.checks.iter().flatten().filter_map(|term| if let Term::Is(it) = term { Some(*it) } else { None })
    }

    /// Whether states must say on which ports tasks wait.
    pub(crate) fn names_ports(&self) -> bool {
        let asks = |predicate| matches!(predicate, Predicate::Answered { .. });
        self.watches.iter().any(|w| matches!(w, CellProperty::Served { .. })) || self.predicates().any(asks)
    }
}
