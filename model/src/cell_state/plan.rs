//! Scenarios to explore: a cell, what its tasks do, links, fault budgets, and the properties that are checked.

use imrs_protocol::script::{Predicate, Program, Term};
use imrs_protocol::{CellTable, NodeId, NodeTable, PortId, ServiceOrder, Target, TaskId, Ticks};
use std::sync::Arc;

/// How often something is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// At most this often.
    Most(u8),
    /// Without limit.
    Endless,
}

/// What the thread of a task does whenever it is idle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errand {
    /// The thread does nothing: it never makes an API call.
    Rest,
    /// Sends messages or queries.
    Send {
        /// The port.
        port: PortId,
        /// The receivers.
        to: Target,
        /// How often the task sends.
        times: Times,
        /// Fewest ticks between two sends.
        every: u8,
    },
    /// Sends status messages under its lease, while it is active (D61).
    Order {
        /// The port.
        port: PortId,
        /// How often the task sends.
        times: Times,
    },
    /// Receives messages, and serves each for the ticks of [`TaskPlan::service`].
    Receive {
        /// The port; `None`: the most urgent message of all ports.
        port: Option<PortId>,
        /// How long it waits for a message; `None`: without limit.
        time_out: Option<Ticks>,
    },
    /// Runs an action, which handlers may interrupt.
    Work {
        /// Fewest ticks of an action.
        least: u8,
        /// Most ticks of an action.
        most: u8,
        /// How often the task runs an action.
        times: Times,
    },
    /// Reaches a waitfor.
    Meet {
        /// The port.
        port: PortId,
        /// How often the task reaches the waitfor.
        times: Times,
    },
    /// Delays.
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
    /// The ports that it has handlers for.
    pub handles: Vec<PortId>,
    /// The task's `order` of service.
    pub order: ServiceOrder,
    /// For how many ticks, at least and at most, the task or its handler serves a message before it answers.
    pub service: (u8, u8),
    /// A command that a handler may send before it answers.
    pub nested: Option<PortId>,
    /// Whether the task is eager: its thread does the next errand at once, not at any time.
    pub hurry: bool,
    /// The program that it runs instead of an errand.
    pub script: Option<Arc<Program>>,
}

impl TaskPlan {
    /// A task with this errand and no handlers. It acts and answers at any time.
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

    /// Has handlers for these ports.
    #[must_use]
    pub fn handling(self, ports: &[PortId]) -> Self {
        Self { handles: ports.to_vec(), ..self }
    }

    /// The same task with this `order` of service.
    #[must_use]
    pub fn ordered(self, order: ServiceOrder) -> Self {
        Self { order, ..self }
    }

    /// Its handlers may send a command on this port before they answer.
    #[must_use]
    pub fn nesting(self, port: PortId) -> Self {
        Self { nested: Some(port), ..self }
    }
}

/// How many faults there may be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Lost packets; [`u8::MAX`]: any number.
    pub loss: u8,
    /// Duplicated packets.
    pub dup: u8,
    /// Crashes; a crashed node may restart, in its next incarnation.
    pub crash: u8,
    /// Ticks that a node's clock leaves out or counts twice.
    pub drift: u8,
    /// Ticks that a node notices only at the next tick or at its next input.
    pub late: u8,
    /// Packets that are charged one tick more than their link's bound (D20).
    pub over: u8,
}

/// How packets cross a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Packets take any time up to the link's bound, and may overtake each other.
    Any,
    /// In exactly the link's bound, in the order they left.
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
    /// No queued message has more time left than its sender waits for it.
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
    /// A handler runs only when it outranks what it interrupts.
    Order,
    /// At one task, a port's head is bypassed and a message is rejected at most this often.
    Fair {
        /// The task.
        task: TaskId,
        /// Most bypasses of a head by GETs over all ports.
        bypasses: u8,
        /// Most rejections of one message.
        refusals: u8,
    },
    /// No message of this port is dropped, and no wait on it ends by its time_out.
    Served {
        /// The port.
        port: PortId,
    },
    /// No command that can still arrive is dropped for space while its transit buffer holds a status message (D60).
    Eviction,
    /// Between two ticks every task gets at most `signals` signals.
    Zeno {
        /// The most signals.
        signals: u8,
    },
    /// Of the tasks of a couple at most one is active (D61).
    OneActive,
    /// A task that has received an order of one epoch executes none of an older one (D61). Orders carry an epoch.
    FencedOrders,
    /// The search must reach this goal, as a counterexample to "never"; otherwise the other properties hold vacuously.
    Reach(Goal),
}

/// A goal for [`CellProperty::Reach`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// A handler interrupts a handler.
    Nested,
    /// A source hears that a relay refused its command.
    RefusedOnTheWay,
    /// A task is told that its command was refused.
    Refused,
    /// A task is told that its command was never sent.
    Unsent,
    /// A command is answered.
    Answered,
    /// A query to several comes back with every answer.
    AllAnswered,
    /// Each end of a link waits for room in the buffer of the other end.
    BuffersFull,
    /// The second task is active: it took over.
    TookOver,
    /// A lease ends.
    Fenced,
    /// A message that waited leaves its buffer, whether it is handed over or dropped.
    Left,
}

/// All that the search of a cell needs.
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
    /// Whether a link takes a packet only if the next node's transit buffer has room for it.
    pub pressure: bool,
    /// How packets cross links.
    pub transfer: Transfer,
    /// Faults.
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
    /// The first epoch of couples and their actuators: even. A restarted node begins with the machine's own.
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

    /// Adds a property.
    #[must_use]
    pub fn watching(mut self, watch: CellProperty) -> Self {
        self.watches.push(watch);
        self
    }

    /// The table as `node` sees it.
    #[must_use]
    pub fn table(&self, node: NodeId) -> NodeTable {
        NodeTable::new(Arc::clone(&self.cell), node)
    }

    /// How many nodes there are.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.cell.cell().nodes.len()
    }

    /// Whether a node is left out.
    pub(crate) const fn leaves_out(&self, node: usize) -> bool {
        self.left_out != 0 && node < 64 && self.left_out >> node & 1 == 1
    }

    /// Whether a task is on a node that is left out.
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

    /// By how many ticks the kept true remaining times of messages exceed the declared ones. `None`: no such times are kept.
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

    /// The predicates of its checks.
    pub(crate) fn predicates(&self) -> impl Iterator<Item = Predicate> {
        self.checks.iter().flatten().filter_map(|term| if let Term::Is(it) = term { Some(*it) } else { None })
    }

    /// Whether states must say on which ports tasks wait.
    pub(crate) fn names_ports(&self) -> bool {
        let asks = |predicate| matches!(predicate, Predicate::Answered { .. });
        self.watches.iter().any(|w| matches!(w, CellProperty::Served { .. })) || self.predicates().any(asks)
    }
}
