//! The model checkers: exhaustive searches through the states of the one state machine of `imrs-protocol`.
//!
//! A [`Scenario`] describes nodes, tasks, faults and a property; [`explore`] visits every state within its bounds.
//! [`verify`] checks the protocol's claims, each under the default rules and under the variants that must fail.

#![forbid(unsafe_code)]

pub mod cell;
pub mod cell_state;
mod chart;
mod claims;
mod explore;
mod explorer;
mod fused;
mod network;
mod report;
mod scenario;
mod side_by_side;
mod spec_state;
mod state;
mod symmetry;
mod world;
pub mod worlds;
mod zone;

pub use chart::{Counterexample, draw};
pub use claims::{Options, Progress, Silent, claim_names, verify};
pub use explore::{Exploration, Limits, WorldModel, explore};
pub use explorer::{Explorer, ExplorerError};
pub use fused::{Compared, compared};
pub use report::{Bounds, Found, Outcome, Report, Verdict, collision_probability};
pub use scenario::{Behaviour, Budget, Reductions, Scenario, Timing, Watch};
pub use state::{Packed, Violation};
pub use world::Action;
