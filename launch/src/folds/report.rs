//! What one launcher reports of a run, and the file format of such a report.

use super::attendance::Attended;
use super::trouble::Trouble;
use crate::cells::Loaded;
use crate::checks::Settlement;
use crate::pipe::Figures;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The version of the file format.
const VERSION: u32 = 1;
/// The value of the field `format` in each file.
const FORMAT: &str = "imrs report";

/// What one launcher reports of a run: `imrs run --report` writes it to a file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Report {
    /// The name of the cell.
    pub cell: String,
    /// How long the tasks ran, in seconds.
    pub seconds: f64,
    /// The seed of the injected losses and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that were dropped on purpose.
    pub loss: f64,
    /// Whether the nodes ran under the real-time scheduler.
    pub rt: bool,
    /// The nodes that this launcher ran.
    pub nodes: Vec<NodeReport>,
    /// The scripts that ended by themselves.
    pub tasks: Vec<TaskSummary>,
    /// The tasks that gave up because a node was killed.
    pub after_kill: Vec<AfterKill>,
    /// The rounds of waitfors in which the tasks took part.
    pub attended: Vec<Attended>,
    /// The verdicts on the checks of the cell.
    pub checks: Settlement,
    /// The problems of the run that are not in the other fields.
    pub trouble: Vec<Trouble>,
    /// What the launcher could not observe, one line each.
    pub incomplete: Vec<String>,
}

/// What a launcher reports of one node.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NodeReport {
    /// The node's name.
    pub name: String,
    /// How the node's process ended.
    pub exit: String,
    /// The counters of each incarnation.
    pub incarnations: Vec<Figures>,
    /// How often too many datagrams came that no node of the cell sent.
    pub alarms: u64,
}

/// A script that ended by itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSummary {
    /// The name of the script's task.
    pub name: String,
    /// How the script ended.
    pub end: String,
}

/// A task that gave up because a node was killed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AfterKill {
    /// The killed node.
    pub killed: String,
    /// The task that waited for a task on the killed node.
    pub task: String,
    /// How long the task had waited, in microseconds: its time_out plus the lateness of this machine.
    pub waited_us: u64,
    /// The time_out of the waitfor, in microseconds.
    pub time_out_us: u64,
    /// The time from the kill to the instant at which the task gave up, in microseconds.
    pub after_kill_us: u64,
}

/// Why a report cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file is no report of a run.
    #[error("is no report of a run: name files that `imrs run CELL --node NAME --report FILE` wrote")]
    NoReport,
    /// The file has another version.
    #[error(
        "is a report of version {0}, and this program reads version {VERSION}: use the version of imrs that wrote it"
    )]
    Version(u32),
    /// The report is damaged.
    #[error("is damaged: {0}: copy it again from its machine")]
    Damaged(String),
    /// The report is of another cell.
    #[error(
        "is a report of another cell: its {what} differ (digest {theirs} there, {ours} here); name the cell file that its machine ran"
    )]
    OtherCell {
        /// `declarations` or `statements`.
        what: &'static str,
        /// The digest in the report.
        theirs: String,
        /// The digest of the cell file.
        ours: String,
    },
}

/// The first fields of a file.
#[derive(Serialize, Deserialize)]
struct Head {
    format: String,
    version: u32,
}

#[derive(Serialize, Deserialize)]
struct File<R> {
    #[serde(flatten)]
    head: Head,
    declarations: String,
    statements: String,
    report: R,
}

/// The digests of a cell's declarations and statements.
fn digests(loaded: &Loaded) -> [(&'static str, String); 2] {
    [("declarations", loaded.table.digest()), ("statements", loaded.all_statements())]
        .map(|(what, digest)| (what, format!("{digest:08x}")))
}

/// The greatest number that a report may have. In microseconds this is 12 days. Sums of such numbers cannot overflow.
const LARGEST: u64 = 1 << 40;

/// Whether sums of the report's numbers cannot overflow. The seed is never added to anything, so it may have any
/// value.
fn is_countable(value: &Value) -> bool {
    match value {
        Value::Number(number) => {
            number.as_i64().map_or_else(|| number.is_f64(), |number| number.unsigned_abs() <= LARGEST)
        }
        Value::Array(all) => all.iter().all(is_countable),
        Value::Object(all) => all.iter().all(|(key, value)| key == "seed" || is_countable(value)),
        Value::Null | Value::Bool(_) | Value::String(_) => true,
    }
}

impl Report {
    /// The text of the file.
    #[must_use]
    pub fn text(&self, loaded: &Loaded) -> String {
        let [(_, declarations), (_, statements)] = digests(loaded);
        let head = Head { format: FORMAT.into(), version: VERSION };
        // All keys are text and all numbers are finite, so this cannot fail.
        serde_json::to_string(&File { head, declarations, statements, report: self }).unwrap_or_default()
            + "\n"
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn read(text: &str, loaded: &Loaded) -> Result<Self, ReportError> {
        let head: Head = match serde_json::from_str(text) {
            Ok(head) => head,
            // A file with this beginning is a report, but its end is missing.
            Err(error) if text.starts_with(&format!("{{\"format\":\"{FORMAT}\"")) => {
                return Err(ReportError::Damaged(error.to_string()));
            }
            Err(_) => return Err(ReportError::NoReport),
        };
        if head.format != FORMAT {
            return Err(ReportError::NoReport);
        }
        if head.version != VERSION {
            return Err(ReportError::Version(head.version));
        }
        let damaged = |error: serde_json::Error| ReportError::Damaged(error.to_string());
        let value: Value = serde_json::from_str(text).map_err(damaged)?;
        if !is_countable(&value) {
            return Err(ReportError::Damaged("a number is too large".into()));
        }
        let file: File<Self> = serde_json::from_value(value).map_err(damaged)?;
        for ((what, ours), theirs) in digests(loaded).into_iter().zip([file.declarations, file.statements]) {
            if ours != theirs {
                return Err(ReportError::OtherCell { what, theirs, ours });
            }
        }
        let nodes = loaded.table.cell().nodes.len();
        let mut links = file.report.nodes.iter().flat_map(|node| &node.incarnations).flat_map(|of| &of.links);
        if let Some(link) = links.find(|link| link.peer.index() >= nodes) {
            return Err(ReportError::Damaged(format!("the cell has no node {}", link.peer.index())));
        }
        Ok(file.report)
    }
}
