//! What a floor is made of: a cell, what its tasks do, what links and faults may do, what is watched.

use imrs_protocol::script::{Predicate, Program, Term};
use imrs_protocol::{CellTable, NodeId, NodeTable, PortId, ServiceOrder, Target, TaskId, Ticks};
use std::sync::Arc;

/// How often something is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// So often at most.
    Most(u8),
    /// Without end.
    Endless,
}

/// What the thread of a task does whenever it is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errand {
    /// Nothing: it neither asks for anything nor ever will.
    Rest,
    /// Sends or queries.
    Send {
        /// The port.
        port: PortId,
        /// Who it asks.
        to: Target,
        /// How often.
        times: Times,
        /// So many ticks at least between two sends.
        every: u8,
    },
    /// Sends a status message under its lease, while it acts (D61).
    Order {
        /// The port.
        port: PortId,
        /// How often.
        times: Times,
    },
    /// Receives, and keeps each message for the ticks of its service.
    Receive {
        /// From one port, or the most urgent of all.
        port: Option<PortId>,
        /// How long it waits for one.
        time_out: Option<Ticks>,
    },
    /// Acts on the world, which handlers may interrupt.
    Work {
        /// So many ticks at least.
        least: u8,
        /// So many at most.
        most: u8,
        /// How often.
        times: Times,
    },
    /// Reaches a waitfor.
    Meet {
        /// The port.
        port: PortId,
        /// How often.
        times: Times,
    },
    /// Delays.
    Delay {
        /// For so long.
        length: Ticks,
        /// How often.
        times: Times,
    },
}

/// A task of the floor.
#[derive(Clone, Debug)]
pub struct TaskPlan {
    /// What its thread does.
    pub errand: Errand,
    /// The ports that it has handlers for.
    pub handles: Vec<PortId>,
    /// Its `order`.
    pub order: ServiceOrder,
    /// How many ticks, at least and at most, a received message keeps the task or its handler before it is answered.
    pub service: (u8, u8),
    /// A command that a handler may send before it answers.
    pub nested: Option<PortId>,
    /// Whether the thread does its next errand at once, rather than whenever it likes.
    pub hurry: bool,
    /// The program that it runs instead of an errand.
    pub script: Option<Arc<Program>>,
}

impl TaskPlan {
    /// A task with this errand, without handlers, which does it whenever it likes and answers at once or later.
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

    /// A task that runs a program. Its `order` is what the watches believe; the program must say the same.
    #[must_use]
    pub fn scripted(program: Arc<Program>) -> Self {
        Self { script: Some(program), ..Self::new(Errand::Rest) }
    }

    /// Does its errand at once whenever it is free.
    #[must_use]
    pub fn hurried(self) -> Self {
        Self { hurry: true, ..self }
    }

    /// Keeps each message for so many ticks.
    #[must_use]
    pub fn serving(self, least: u8, most: u8) -> Self {
        Self { service: (least, most), ..self }
    }

    /// Has handlers for these ports.
    #[must_use]
    pub fn handling(self, ports: &[PortId]) -> Self {
        Self { handles: ports.to_vec(), ..self }
    }

    /// Ranks what it is asked.
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
    /// Crashes; a node may start again, in its next life.
    pub crash: u8,
    /// Ticks that a node's clock leaves out or counts twice.
    pub drift: u8,
    /// Ticks that a node notices only with the next one, or when something else happens to it.
    pub late: u8,
    /// Packets that are charged one tick more than their link's bound (D20).
    pub over: u8,
}

/// How packets cross a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// In any time up to the link's bound, overtaking each other.
    Any,
    /// In exactly the link's bound, in the order they left.
    Exact,
}

/// What is watched. Several watches look at one floor; the first that finds something ends the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FloorWatch {
    /// No message is handed over later than so many ticks after its sender's time_out.
    Stale {
        /// What drifting clocks may add.
        slack: u8,
    },
    /// No message that waits has more time left than its sender waits for it.
    TimeToLive,
    /// No message waits any longer once its sender's time_out is over.
    Expires,
    /// Every wait ends within its time_out, one tick and this slack; every request gets one answer, and the right one.
    Waits {
        /// What late and drifting clocks may add.
        slack: u8,
    },
    /// No message is handed over twice.
    AtMostOnce,
    /// A command whose sender is told that it was refused, or never sent, has not run and does not run later.
    DidNotRun,
    /// A handler runs only when it outranks what it interrupts.
    Order,
    /// A head is bypassed, and a message refused, at most so often at this task.
    Fair {
        /// The task.
        task: TaskId,
        /// Bypasses of a head by GETs over all ports.
        bypasses: u8,
        /// Refused offers of one message.
        refusals: u8,
    },
    /// No message of this port is dropped, and no wait on it ends by its time_out.
    Served {
        /// The port.
        port: PortId,
    },
    /// No command that can still arrive is dropped for space while its transit buffer holds a status message (D60).
    Eviction,
    /// Between two ticks every task gets at most so many signals.
    Zeno {
        /// How many.
        signals: u8,
    },
    /// Of the tasks that are in a couple at most one acts (D61).
    OneActive,
    /// Whoever has heard of an order of an epoch executes none of an older one (D61). Orders say their epoch.
    FencedOrders,
    /// Shown by a counterexample to "never": something that must be possible for the other watches to mean anything.
    Reach(Goal),
}

/// What a floor may be asked to show.
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
    /// Both ends of a link wait for each other's buffer.
    BuffersFull,
    /// The second task acts: it took over.
    TookOver,
    /// A lease ends.
    Fenced,
    /// A message that waited leaves its buffer, whether it is handed over or dropped.
    Left,
}

/// A whole floor to explore.
#[derive(Clone, Debug)]
pub struct FloorPlan {
    /// The cell's table.
    pub cell: Arc<CellTable>,
    /// What each task does, by task.
    pub tasks: Vec<TaskPlan>,
    /// How many packets a node's transit buffer holds.
    pub transit: u16,
    /// How many packets each direction of a link takes in one tick; `None`: any number.
    pub room: Option<u8>,
    /// Whether a link takes a packet only where the next node's buffer has room for it, or the packet ends there.
    pub pressure: bool,
    /// How packets cross links.
    pub way: Way,
    /// Faults.
    pub faults: Faults,
    /// What is watched.
    pub watches: Vec<FloorWatch>,
    /// Expressions over the tasks' scripts that must be true in every state.
    pub checks: Vec<Vec<Term>>,
    /// Whether what follows from a step within its node, and what a task in a hurry does next, belong to the step.
    pub fused: bool,
    /// Whether states keep which messages were taken although no copy of them can come any more.
    pub keeps_seen: bool,
    /// Whether the floor is followed from its start and never loaded: what came before is judged, too.
    pub(crate) history: bool,
    /// Whether ticks in which nothing happens and nothing else can are passed over at once.
    pub jumps: bool,
    /// For each node, how far its clock is ahead.
    pub clocks: Vec<u64>,
    /// The epoch that couples and their actuators begin at: even. A node that starts again does where the machine lets it.
    pub epoch: u8,
    /// Nodes, bit by bit, that are left out: they are down for ever, and nothing of them or of their tasks is packed.
    pub(crate) left_out: u64,
}

impl FloorPlan {
    /// A floor without faults and limits on its links.
    #[must_use]
    pub fn new(cell: Arc<CellTable>, tasks: Vec<TaskPlan>) -> Self {
        let clocks = vec![0; cell.cell().nodes.len()];
        Self {
            cell,
            tasks,
            transit: 4,
            room: None,
            pressure: false,
            way: Way::Any,
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

    /// Watches this, too.
    #[must_use]
    pub fn watching(mut self, watch: FloorWatch) -> Self {
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

    /// Whether nodes can have more than one life.
    #[must_use]
    pub const fn lives(&self) -> bool {
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
            .find_map(|w| if let FloorWatch::Stale { slack } = *w { Some(slack) } else { None })
    }

    /// Whether the true times to live of messages are kept, and how much longer than declared.
    pub(crate) fn times_messages(&self) -> Option<u8> {
        let held = [FloorWatch::TimeToLive, FloorWatch::Expires];
        self.stale().or_else(|| held.into_iter().any(|watch| self.watches(watch)).then_some(0))
    }

    pub(crate) fn waits(&self) -> Option<u8> {
        self.watches
            .iter()
            .find_map(|w| if let FloorWatch::Waits { slack } = *w { Some(slack) } else { None })
    }

    pub(crate) fn fair(&self) -> Option<(TaskId, u8, u8)> {
        self.watches.iter().find_map(|w| match *w {
            FloorWatch::Fair { task, bypasses, refusals } => Some((task, bypasses, refusals)),
            _ => None,
        })
    }

    pub(crate) fn zeno(&self) -> Option<u8> {
        self.watches
            .iter()
            .find_map(|w| if let FloorWatch::Zeno { signals } = w { Some(*signals) } else { None })
    }

    pub(crate) fn watches(&self, watch: FloorWatch) -> bool {
        self.watches.contains(&watch)
    }

    /// Whether refusals must be counted.
    pub(crate) fn counts_refusals(&self) -> bool {
        self.fair().is_some() || self.watches(FloorWatch::Order)
    }

    /// The predicates of its checks.
    pub(crate) fn predicates(&self) -> impl Iterator<Item = Predicate> {
        self.checks.iter().flatten().filter_map(|term| if let Term::Is(it) = term { Some(*it) } else { None })
    }

    /// Whether the ports on which tasks wait matter.
    pub(crate) fn names_ports(&self) -> bool {
        let asks = |predicate| matches!(predicate, Predicate::Answered { .. });
        self.watches.iter().any(|w| matches!(w, FloorWatch::Served { .. })) || self.predicates().any(asks)
    }
}
