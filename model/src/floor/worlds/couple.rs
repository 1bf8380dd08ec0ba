//! Two work-coupled tasks whose communication tasks exchange beats (D30, D61).

use crate::floor::plan::{Errand, Faults, FloorPlan, FloorWatch, TaskPlan};
use imrs_protocol::rules::{LeaseRule, Rules};
use imrs_protocol::{Cell, CellError, CellTable, CoupleDecl, PortDecl, Ticks, Usage};
use std::sync::Arc;

/// A primary and its standby, each on a node of its own.
#[derive(Clone, Debug)]
pub struct Couple {
    /// The longest way of a packet in ticks.
    pub delay: u64,
    /// The lease in ticks.
    pub lease: u64,
    /// The take-over in ticks.
    pub takeover: u64,
    /// The period of the beats in ticks.
    pub every: u64,
    /// Whether the roles are exchanged at a take-over.
    pub mutual: bool,
    /// How the lease is kept.
    pub rule: LeaseRule,
    /// Faults.
    pub faults: Faults,
    /// What is watched.
    pub watch: FloorWatch,
}

impl Couple {
    /// The floor.
    ///
    /// # Errors
    /// What is wrong with the declaration.
    pub fn plan(&self) -> Result<Arc<FloorPlan>, Vec<CellError>> {
        let mut cell = Cell::new("couple", Ticks(1));
        cell.rules = Rules { lease: self.rule, ..Rules::DEFAULT };
        let [here, there] = ["primary", "standby"].map(|name| cell.node(name));
        cell.link(here, there, Ticks(self.delay));
        let (primary, standby) = (cell.task("P", here), cell.task("S", there));
        // A beat lives no longer than it may take.
        let life = Ticks(2 * self.delay + 1);
        let via = cell.port(PortDecl::new("alive", primary, Usage::Response, &[standby], life));
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
        // Both wait for ever, so that they are told at once of what becomes of their lease.
        let wait = Errand::Receive { port: None, time_out: None };
        let task = || TaskPlan::new(wait).hurried().serving(0, 0);
        let tasks = vec![task(), task()];
        let mut plan = FloorPlan::new(Arc::new(CellTable::new(cell)?), tasks).watching(self.watch);
        plan.faults = self.faults;
        Ok(Arc::new(plan))
    }
}
