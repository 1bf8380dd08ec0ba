//! Checker scenarios ([`CellScenario`]) of two work-coupled tasks whose communication tasks exchange heartbeats (D30, D61).

use crate::cell_state::plan::{CellProperty, CellScenario, Errand, Faults, TaskPlan, Times};
use imrs_protocol::rules::{LeaseRule, Rules};
use imrs_protocol::{Cell, CellError, CellTable, CoupleDecl, NodeId, PortDecl, PortId, TaskId, Ticks, Usage};
use std::sync::Arc;

/// A primary and its standby, each on a node of its own.
#[derive(Clone, Debug)]
pub struct Couple {
    /// The longest link delay in ticks.
    pub delay: u64,
    /// The length of the lease in ticks.
    pub lease: u64,
    /// How long after the last answer the standby takes over, in ticks.
    pub takeover: u64,
    /// The period of the heartbeats in ticks.
    pub every: u64,
    /// Whether primary and standby exchange roles at a take-over.
    pub mutual: bool,
    /// The rule by which the primary keeps its lease.
    pub rule: LeaseRule,
    /// The first epoch of both tasks, an even number.
    pub epoch: u8,
    /// How many faults the scenario may have, and which.
    pub faults: Faults,
    /// The property that is checked.
    pub watch: CellProperty,
}

impl Couple {
    fn cell(&self) -> Cell {
        let mut cell = Cell::new("couple", Ticks(1));
        cell.rules = Rules { lease: self.rule, ..Rules::DEFAULT };
        let [here, there] = ["primary", "standby"].map(|name| cell.node(name));
        cell.link(here, there, Ticks(self.delay));
        let (primary, standby) = (cell.task("P", here), cell.task("S", there));
        // The TTL of a heartbeat is no longer than its round trip may take.
        let ttl = Ticks(2 * self.delay + 1);
        let via = cell.port(PortDecl::new("alive", primary, Usage::Response, &[standby], ttl));
        cell.couples.push(CoupleDecl {
            primary,
            standby,
            lease: Ticks(self.lease),
            takeover: Ticks(self.takeover),
            every: Ticks(self.every),
            via,
            trusted: true,
            mutual: self.mutual,
        });
        cell
    }

    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        // Both tasks wait without limit, so that each learns at once when it gets or loses its lease.
        let wait = Errand::Receive { port: None, time_out: None };
        let task = || TaskPlan::new(wait).hurried().serving(0, 0);
        let tasks = vec![task(), task()];
        let mut plan = CellScenario::new(Arc::new(CellTable::new(self.cell())?), tasks).watching(self.watch);
        (plan.faults, plan.epoch) = (self.faults, self.epoch);
        Ok(Arc::new(plan))
    }
}

/// A couple and the arm that it commands, each on a node of its own. Primary and standby give their orders through
/// different ports of the arm.
#[derive(Clone, Debug)]
pub struct Orders {
    /// The couple that gives the orders.
    pub couple: Couple,
    /// The longest link delay of an order in ticks.
    pub delay: u64,
    /// The TTL of an order in ticks.
    pub ttl: u64,
    /// How many orders each task of the couple gives.
    pub orders: u8,
    /// Whether the arm drops orders of older epochs.
    pub heed: bool,
}

impl Orders {
    /// The scenario.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn plan(&self) -> Result<Arc<CellScenario>, Vec<CellError>> {
        let mut cell = self.couple.cell();
        cell.rules.heed_epochs = self.heed;
        let there = cell.node("arm");
        let arm = cell.task("A", there);
        let couple = cell.couples[0].clone();
        let mut port = |name: &str, from: TaskId, node: NodeId| {
            cell.link(node, there, Ticks(self.delay));
            let port = PortDecl::new(name, arm, Usage::Receive, &[from], Ticks(self.ttl));
            cell.port(port.bounded_buffer(2).guard(0))
        };
        let ports = [port("move", couple.primary, NodeId(0)), port("grip", couple.standby, NodeId(1))];
        let orders = |port: PortId| {
            TaskPlan::new(Errand::Order { port, times: Times::Most(self.orders) }).serving(0, 0)
        };
        let executes = TaskPlan::new(Errand::Receive { port: None, time_out: None }).serving(0, 0);
        let tasks = vec![orders(ports[0]), orders(ports[1]), executes];
        let mut plan = CellScenario::new(Arc::new(CellTable::new(cell)?), tasks).watching(self.couple.watch);
        (plan.faults, plan.epoch) = (self.couple.faults, self.couple.epoch);
        Ok(Arc::new(plan))
    }
}
