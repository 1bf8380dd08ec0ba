//! The scenarios that the protocol's claims explore.

mod couple;
mod served;

pub use couple::{Couple, Orders};
pub use served::{Flood, Interrupted, Workshop, penalised, query_all, refused};

use super::plan::{CellProperty, CellScenario, Errand, Faults, TaskPlan, Times};
use imrs_protocol::rules::Rules;
use imrs_protocol::{Cell, CellError, CellTable, PortDecl, PortId, Target, TaskId, Ticks, Usage};
use std::sync::Arc;

/// Two senders on one node, a relay, and a receiver on the third node. The first sender sends commands, the second one
/// statuses or commands, each on a port of its own.
#[derive(Clone, Debug)]
pub struct Relay {
    /// The TTLs of the first and of the second sender's messages, in ticks.
    pub time_out: (u64, u64),
    /// The bound of each of the two links, in ticks.
    pub delay: u64,
    /// How often a command is retransmitted, and the period of retransmission in ticks.
    pub retry: (u8, u64),
    /// How many messages each sender sends.
    pub sends: (u8, u8),
    /// Whether the second sender sends commands, too.
    pub commands: bool,
    /// The size of the receiver's buffers: `bounded_buffer[n]`.
    pub buffer: u16,
    /// How many packets a node's transit buffer holds.
    pub transit: u16,
    /// How many packets a link takes in one tick.
    pub room: Option<u8>,
    /// The faults that may happen.
    pub faults: Faults,
    /// The rules of the protocol.
    pub rules: Rules,
    /// The properties that are checked.
    pub watches: Vec<CellProperty>,
    /// For each node, how many ticks its clock is ahead.
    pub clocks: [u64; 3],
}

impl Default for Relay {
    fn default() -> Self {
        Self {
            time_out: (6, 6),
            delay: 1,
            retry: (0, 0),
            sends: (1, 1),
            commands: false,
            buffer: 2,
            transit: 2,
            room: None,
            faults: Faults::default(),
            rules: Rules::DEFAULT,
            watches: Vec::new(),
            clocks: [0; 3],
        }
    }
}

impl Relay {
    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        let mut cell = Cell::new("relay", Ticks(1));
        cell.rules = self.rules;
        let [a, r, b] = ["left", "relay", "right"].map(|name| cell.node(name));
        cell.link(a, r, Ticks(self.delay));
        cell.link(r, b, Ticks(self.delay));
        let (x, y, z) = (cell.task("X", a), cell.task("Y", a), cell.task("Z", b));
        let command = |port: PortDecl| port.command().retry(self.retry.0, Ticks(self.retry.1));
        let port = |name: &str, owner: TaskId, ttl: u64| {
            PortDecl::new(name, owner, Usage::Send, &[z], Ticks(ttl)).bounded_buffer(self.buffer)
        };
        let first = cell.port(command(port("move", x, self.time_out.0)));
        let second = port("state", y, self.time_out.1);
        let second = cell.port(if self.commands { command(second) } else { second });
        let sender = |port: PortId, times: u8| {
            TaskPlan::new(Errand::Send { port, to: Target::All, times: Times::Most(times), every: 0 })
        };
        let receiver = TaskPlan::new(Errand::Receive { port: None, time_out: None });
        let tasks = vec![sender(first, self.sends.0), sender(second, self.sends.1), receiver];
        let mut plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks);
        plan.transit = self.transit;
        plan.room = self.room;
        plan.faults = self.faults;
        plan.watches.clone_from(&self.watches);
        plan.clocks = self.clocks.to_vec();
        Ok(Arc::new(plan))
    }
}

/// A task that waits for an answer that never comes, and a task on the same node that never makes an API call.
///
/// # Errors
/// The errors of the cell's declaration.
pub fn busy_neighbour(rules: Rules) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("busy", Ticks(1));
    cell.rules = rules;
    let [here, there] = ["here", "there"].map(|name| cell.node(name));
    cell.link(here, there, Ticks(1));
    let (asker, _) = (cell.task("asker", here), cell.task("worker", here));
    let deaf = cell.task("deaf", there);
    let port = cell.port(PortDecl::new("ask", asker, Usage::Send, &[deaf], Ticks(4)).command());
    let send = Errand::Send { port, to: Target::All, times: Times::Most(2), every: 0 };
    let tasks = vec![TaskPlan::new(send), TaskPlan::new(Errand::Rest), TaskPlan::new(Errand::Rest)];
    let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks);
    Ok(Arc::new(plan.watching(CellProperty::Waits { slack: 0 }).watching(CellProperty::Zeno { signals: 2 })))
}

/// Two tasks of one node delay under the same timer id, and each waits for its own delay (§5.1.2).
///
/// # Errors
/// The errors of the cell's declaration.
pub fn delays(lengths: [u64; 2]) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("delays", Ticks(1));
    let node = cell.node("node");
    let tasks = [("long", lengths[0]), ("short", lengths[1])].map(|(name, length)| {
        cell.task(name, node);
        TaskPlan::new(Errand::Delay { length: Ticks(length), times: Times::Most(2) })
    });
    let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks.into());
    Ok(Arc::new(plan.watching(CellProperty::Waits { slack: 0 })))
}

/// A chain of four nodes whose transit buffers hold one packet each. A node passes a packet on only if the next node has
/// space. So the buffers of the two inner nodes can be full of packets for each other.
///
/// # Errors
/// The errors of the cell's declaration.
pub fn full_buffers(sends: u8, watch: CellProperty) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("buffers", Ticks(1));
    let nodes = ["c", "a", "b", "d"].map(|name| cell.node(name));
    for pair in nodes.windows(2) {
        cell.link(pair[0], pair[1], Ticks(1));
    }
    let named = [("U", nodes[0]), ("X", nodes[1]), ("Y", nodes[2]), ("V", nodes[3])];
    let [u, x, y, v] = named.map(|(name, node)| cell.task(name, node));
    let port = |name: &str, from: TaskId, to: TaskId| {
        PortDecl::new(name, from, Usage::Send, &[to], Ticks(7)).command()
    };
    let (east, west) = (cell.port(port("east", x, v)), cell.port(port("west", y, u)));
    // On each inner node a second task sends while the first task waits.
    let [x2, y2] = [("X2", nodes[1]), ("Y2", nodes[2])].map(|(name, node)| cell.task(name, node));
    let (east2, west2) = (cell.port(port("east2", x2, v)), cell.port(port("west2", y2, u)));
    let sender = |port: PortId| {
        TaskPlan::new(Errand::Send { port, to: Target::All, times: Times::Most(sends), every: 0 })
    };
    let receiver = || TaskPlan::new(Errand::Receive { port: None, time_out: None }).hurried().serving(0, 0);
    let tasks = vec![receiver(), sender(east), sender(west), receiver(), sender(east2), sender(west2)];
    let mut plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks).watching(watch);
    plan.transit = 1;
    plan.pressure = true;
    plan.transfer = super::plan::Transfer::Exact;
    Ok(Arc::new(plan))
}
