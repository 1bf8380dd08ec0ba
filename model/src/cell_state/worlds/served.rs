//! Checker scenarios in which messages wait for a busy task: they are bypassed by GETs, rejected by rank, or interrupt each
//! other.

use crate::cell_state::plan::{CellProperty, CellScenario, Errand, Faults, TaskPlan, Times};
use imrs_protocol::aging::Service;
use imrs_protocol::rules::{Aging, Rules};
use imrs_protocol::script::{Op, ProgramBuilder};
use imrs_protocol::{
    Cell, CellError, CellTable, PortDecl, Ranked, ServiceOrder, Target, TaskId, Ticks, Usage,
};
use std::sync::Arc;

/// One node: one task receives over all its ports. Some tasks flood ports with urgent statuses. Other tasks send statuses
/// with a longer TTL on one port, and these statuses are bypassed.
#[derive(Clone, Copy, Debug)]
pub struct Flood {
    /// How many ports are flooded.
    pub flooded: u16,
    /// `bounded_buffer[n]` of each flooded port.
    pub room: u16,
    /// The TTL of a flooding status, in ticks.
    pub urgent: u64,
    /// The TTL of a bypassed status, in ticks.
    pub ttl: u64,
    /// `bounded_buffer[n]` of the port with bypassed statuses, and also how many tasks send on it.
    pub buffer: u16,
    /// The least number of ticks between two bypassed statuses of a task.
    pub every: u8,
    /// For how many ticks each message is served.
    pub service: u8,
    /// The rules of the protocol.
    pub rules: Rules,
    /// Whether to check that every bypassed status is served. If not, the check is how often it is bypassed.
    pub served: bool,
}

impl Flood {
    /// The numbers that bound the wait of a bypassed status.
    #[must_use]
    pub fn service(&self) -> Service {
        Service {
            ports: self.flooded + 1,
            levels: 0,
            rank: 0,
            ahead: self.buffer - 1,
            rivals: 0,
            longest: Ticks(u64::from(self.service)),
            penalty: Ticks(1),
        }
    }

    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        let mut cell = Cell::new("flood", Ticks(1));
        cell.rules = self.rules;
        let node = cell.node("node");
        let receiver = cell.task("server", node);
        let mut tasks = vec![
            TaskPlan::new(Errand::Receive { port: None, time_out: None })
                .hurried()
                .serving(self.service, self.service),
        ];
        let sends =
            |port, every| TaskPlan::new(Errand::Send { port, to: Target::All, times: Times::Endless, every });
        for name in ["urgent", "hasty", "rash"].iter().take(usize::from(self.flooded)) {
            let task = cell.task(name, node);
            let ttl = Ticks(self.urgent);
            let port = PortDecl::new(&format!("{name} says"), task, Usage::Send, &[receiver], ttl);
            tasks.push(sends(cell.port(port.bounded_buffer(self.room)), 1));
        }
        let names = ["patient", "steady", "calm"].into_iter().take(usize::from(self.buffer));
        let patient: Vec<TaskId> = names.map(|name| cell.task(name, node)).collect();
        // The port is declared last, so that it also loses every tie.
        let port = PortDecl::new("patient says", receiver, Usage::Receive, &patient, Ticks(self.ttl));
        let asks = cell.port(port.bounded_buffer(self.buffer));
        tasks.extend(patient.iter().map(|_| sends(asks, self.every)));
        let small = |n: u16| u8::try_from(n).unwrap_or(u8::MAX);
        let service = self.service();
        let bypasses = small(service.most_bypasses());
        let watch = if self.served {
            CellProperty::Served { port: asks }
        } else {
            CellProperty::Fair { task: receiver, bypasses, refusals: service.most_refusals() }
        };
        let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks);
        Ok(Arc::new(plan.watching(watch)))
    }
}

/// One node: a task runs actions without end and has handlers. Urgent messages outrank the action. The watched messages,
/// and messages on a rival port, do not.
#[derive(Clone, Copy, Debug)]
pub struct Workshop {
    /// The TTL of the watched messages, in ticks.
    pub ttl: u64,
    /// The least number of ticks between two watched messages of a task.
    pub every: u8,
    /// `bounded_buffer[n]` of the watched port, and also how many tasks send on it.
    pub buffer: u16,
    /// `bounded_buffer[n]` of the rival port, and also how many tasks send on it; 0 if there is no such port.
    pub rivals: u16,
    /// How many ranks are above the watched messages in the `order`: 1 to 3.
    pub rank: u8,
    /// The time penalty of the watched port, and whether the paper's literal penalty applies.
    pub penalty: (u64, bool),
    /// How many ticks a handler runs.
    pub service: u8,
    /// Whether there are urgent messages, too.
    pub urgent: bool,
    /// The rules of the protocol.
    pub rules: Rules,
    /// Whether to check that every watched message is served. If not, the check is how often it is rejected.
    pub served: bool,
}

impl Workshop {
    /// The numbers that bound the wait of a watched message.
    #[must_use]
    pub fn service(&self) -> Service {
        Service {
            ports: 1 + u16::from(self.urgent) + u16::from(self.rivals > 0),
            levels: self.rank + 1 + u8::from(self.rivals > 0),
            rank: self.rank,
            ahead: self.buffer - 1,
            rivals: self.rivals,
            longest: Ticks(u64::from(self.service)),
            penalty: Ticks(self.penalty.0),
        }
    }

    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        let mut cell = Cell::new("workshop", Ticks(1));
        cell.rules = self.rules;
        let node = cell.node("node");
        let worker = cell.task("worker", node);
        let mut refused = |name: &str, sources: &[&str], buffer: u16| {
            let sources: Vec<TaskId> =
                sources.iter().take(usize::from(buffer)).map(|name| cell.task(name, node)).collect();
            let port = PortDecl::new(name, worker, Usage::Receive, &sources, Ticks(self.ttl));
            let mut port = port.bounded_buffer(buffer).penalty(Ticks(self.penalty.0));
            if let Some(penalty) = &mut port.penalty {
                penalty.literal = self.penalty.1;
            }
            cell.port(port)
        };
        let endless =
            |port, every| TaskPlan::new(Errand::Send { port, to: Target::All, times: Times::Endless, every });
        let asks = refused("asks", &["modest", "humble", "meek"], self.buffer);
        let mut senders = vec![endless(asks, self.every); usize::from(self.buffer)];
        let mut handles = vec![asks];
        if self.rivals > 0 {
            let wants = refused("wants", &["rival", "other", "third"], self.rivals);
            senders.extend(vec![endless(wants, 2); usize::from(self.rivals)]);
            handles.push(wants);
        }
        // These entries of the `order` stand above the watched port, so that the port gets the rank
        // `self.rank`.
        let mut named = vec![Ranked::Own, Ranked::Timers, Ranked::Source(worker)];
        named.truncate(usize::from(self.rank));
        if self.urgent {
            let urgent = cell.task("urgent", node);
            let stops = cell.port(PortDecl::new("stops", urgent, Usage::Send, &[worker], Ticks(3)));
            senders.push(endless(stops, 2));
            handles.push(stops);
            named.insert(0, Ranked::Port(stops));
            named.truncate(usize::from(self.rank));
        }
        named.extend(handles.iter().take(1 + usize::from(self.rivals > 0)).map(|&port| Ranked::Port(port)));
        let order = ServiceOrder::new(&named).unwrap_or_default();
        let work = Errand::Work { least: 1, most: 2, times: Times::Endless };
        let mut tasks = vec![
            TaskPlan::new(work)
                .hurried()
                .handling(&handles)
                .ordered(order)
                .serving(self.service, self.service),
        ];
        tasks.extend(senders);
        let service = self.service();
        let watch = if self.served {
            CellProperty::Served { port: asks }
        } else {
            // The port of the rivals is rejected most often, because one more rank is above it.
            let rank = self.rank + u8::from(self.rivals > 0);
            let refusals = Service { rank, ..service }.most_refusals();
            CellProperty::Fair { task: worker, bypasses: u8::MAX, refusals }
        };
        let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks);
        Ok(Arc::new(plan.watching(watch)))
    }
}

/// Two tasks query a third task, which runs actions, across a link or over a relay. The first task's query outranks the
/// action, the second task's query does not. A handler may send a command to a fourth task before it answers.
#[derive(Clone, Debug)]
pub struct Interrupted {
    /// The time_out of the queries, in ticks.
    pub time_out: u64,
    /// How many queries each asking task sends.
    pub queries: u8,
    /// Whether there is a relay between the nodes.
    pub relay: bool,
    /// The faults that may happen.
    pub faults: Faults,
    /// The rules of the protocol.
    pub rules: Rules,
    /// The properties that are checked.
    pub watches: Vec<CellProperty>,
}

impl Interrupted {
    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        let mut cell = Cell::new("interrupted", Ticks(1));
        cell.rules = self.rules;
        let (left, right) = (cell.node("left"), cell.node("right"));
        if self.relay {
            let relay = cell.node("relay");
            cell.link(left, relay, Ticks(1));
            cell.link(relay, right, Ticks(1));
        } else {
            cell.link(left, right, Ticks(1));
        }
        let [chief, peer] = ["chief", "peer"].map(|name| cell.task(name, left));
        let [arm, tool] = ["arm", "tool"].map(|name| cell.task(name, right));
        let query = |name: &str, from: TaskId| {
            PortDecl::new(name, from, Usage::Query, &[arm], Ticks(self.time_out)).bounded_buffer(2)
        };
        let halt = cell.port(query("halt", chief));
        let state = cell.port(query("state", peer));
        let check = cell.port(PortDecl::new("check", arm, Usage::Send, &[tool], Ticks(3)).command());
        let named = [Ranked::Port(halt), Ranked::Own, Ranked::Port(state)];
        let order = ServiceOrder::new(&named).unwrap_or_default();
        let queries = Times::Most(self.queries);
        let asks = |port| TaskPlan::new(Errand::Send { port, to: Target::All, times: queries, every: 0 });
        let work = Errand::Work { least: 1, most: u8::MAX, times: Times::Endless };
        let arm = TaskPlan::new(work).hurried().handling(&[halt, state]).ordered(order).nesting(check);
        let tool = TaskPlan::new(Errand::Receive { port: None, time_out: None }).hurried();
        let mut plan =
            CellScenario::new(Arc::new(CellTable::new(cell)?), vec![asks(halt), asks(state), arm, tool]);
        plan.faults = self.faults;
        plan.watches.clone_from(&self.watches);
        Ok(Arc::new(plan))
    }
}

/// One task queries two tasks at once, each on a node of its own.
///
/// # Errors
/// The errors of the cell's declaration.
pub fn query_all(faults: Faults, watches: Vec<CellProperty>) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("set", Ticks(1));
    let nodes = ["parent", "first", "second"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    cell.link(nodes[0], nodes[2], Ticks(1));
    let [parent, first, second] = [("parent", 0), ("first", 1), ("second", 2)]
        .map(|(name, node): (&str, usize)| cell.task(name, nodes[node]));
    let port = cell.port(PortDecl::new("well", parent, Usage::Query, &[first, second], Ticks(5)));
    let asks = Errand::Send { port, to: Target::All, times: Times::Most(2), every: 0 };
    let answers = || TaskPlan::new(Errand::Receive { port: None, time_out: None }).hurried();
    let mut plan =
        CellScenario::new(Arc::new(CellTable::new(cell)?), vec![TaskPlan::new(asks), answers(), answers()]);
    plan.faults = faults;
    plan.watches = watches;
    Ok(Arc::new(plan))
}

/// A task runs actions without end and never receives. Every offer of a message from another node is rejected, because the
/// message does not outrank the action, unless aging raises its rank.
///
/// # Errors
/// The errors of the cell's declaration.
pub fn refused(
    penalty: (u64, bool),
    aging: Aging,
    watch: CellProperty,
) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("refused", Ticks(1));
    cell.rules.aging = aging;
    let (here, there) = (cell.node("here"), cell.node("there"));
    cell.link(here, there, Ticks(1));
    let (worker, sender) = (cell.task("worker", here), cell.task("sender", there));
    let mut port = PortDecl::new("move", sender, Usage::Send, &[worker], Ticks(4)).penalty(Ticks(penalty.0));
    if let Some(declared) = &mut port.penalty {
        declared.literal = penalty.1;
    }
    let port = cell.port(port);
    let order = ServiceOrder::new(&[Ranked::Own, Ranked::Port(port)]).unwrap_or_default();
    let work = Errand::Work { least: 1, most: u8::MAX, times: Times::Endless };
    let send = Errand::Send { port, to: Target::All, times: Times::Most(1), every: 0 };
    let worker = TaskPlan::new(work).hurried().handling(&[port]).ordered(order);
    let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), vec![worker, TaskPlan::new(send)]);
    Ok(Arc::new(plan.watching(watch)))
}

/// A task runs an action and then receives, again and again; messages do not outrank the action. Under the literal
/// time penalty a rejected message outlives its sender's time_out.
///
/// # Errors
/// The errors of the cell's declaration.
pub fn penalised(literal: bool) -> Result<Arc<CellScenario>, Vec<CellError>> {
    let mut cell = Cell::new("penalised", Ticks(1));
    let node = cell.node("node");
    let (worker, sender) = (cell.task("worker", node), cell.task("sender", node));
    let mut port =
        PortDecl::new("move", sender, Usage::Send, &[worker], Ticks(3)).command().penalty(Ticks(2));
    if let Some(penalty) = &mut port.penalty {
        penalty.literal = literal;
    }
    let port = cell.port(port);
    let order = [Ranked::Own, Ranked::Port(port)];
    let mut script = ProgramBuilder::new("worker");
    script.order(&order);
    script.forever(|b| {
        b.run("act", Ticks(1), Ticks(4));
        b.statement().op(Op::Get { port: None, source: None, time_out: Some(Ticks(1)) });
    });
    script.on_message(port, &[], |b, _| {
        b.reply(&[]);
    });
    let script = Arc::new(script.finish().unwrap_or_default());
    let send = Errand::Send { port, to: Target::All, times: Times::Most(2), every: 0 };
    let worker = TaskPlan::scripted(script).ordered(ServiceOrder::new(&order).unwrap_or_default());
    let tasks = vec![worker, TaskPlan::new(send)];
    let plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks);
    Ok(Arc::new(plan.watching(CellProperty::Stale { slack: 0 })))
}
