//! What is run.

use super::story::Tale;
use crate::args::LaunchArgs;
use crate::cells::{Loaded, Source};
use imrs_protocol::NodeId;
use imrs_runtime::script::Course;
use std::collections::BTreeMap;
use std::time::Duration;

/// What is run, and how.
pub struct Run<'a> {
    /// Where the cell comes from.
    pub source: Source,
    /// The cell.
    pub loaded: &'a Loaded,
    /// How it is run.
    pub args: &'a LaunchArgs,
    /// How long; without end where there is none.
    pub length: Option<Duration>,
    /// By action, the command to execute for it.
    pub actions: BTreeMap<String, Vec<String>>,
    /// What simulated actions give as time goes on.
    pub courses: Vec<Course>,
    /// The only node that is run here, in place of all.
    pub only: Option<NodeId>,
    /// What a demo adds.
    pub tale: Option<Tale>,
}
