//! The checkers.
mod explore;
mod ghost;
mod network;
mod scenario;
mod state;
mod symmetry;
mod world;
pub mod worlds;
pub use explore::{Exploration, Limits, WorldModel, explore};
pub use scenario::{Behaviour, Budget, Reductions, Scenario, Watch};
pub use state::{Packed, Violation};
pub use world::Action;
