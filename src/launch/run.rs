//! The description of a run: which cell, which nodes, how long, and with what.

use super::story::DemoPlan;
use crate::args::LaunchArgs;
use crate::cells::{Loaded, Source};
use imrs_protocol::NodeId;
use imrs_runtime::script::Ramp;
use std::collections::BTreeMap;
use std::time::Duration;

/// A cell that is run, and how.
pub struct Run<'a> {
    /// The text of the cell.
    pub source: Source,
    /// The cell.
    pub loaded: &'a Loaded,
    /// The options of the command line.
    pub args: &'a LaunchArgs,
    /// How long it runs; none: without end.
    pub length: Option<Duration>,
    /// The command to execute for each action.
    pub actions: BTreeMap<String, Vec<String>>,
    /// How results of simulated actions change with time.
    pub ramps: Vec<Ramp>,
    /// The only node that runs here; none: all nodes.
    pub only: Option<NodeId>,
    /// The additions of a demo.
    pub demo: Option<DemoPlan>,
}
