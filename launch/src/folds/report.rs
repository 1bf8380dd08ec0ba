//! What one launcher reports of a run, and the file of it.

use super::attendance::Attended;
use super::trouble::Trouble;
use crate::cells::Loaded;
use crate::checks::Settlement;
use crate::pipe::Figures;
use serde::{Deserialize, Serialize};

/// The version of the files.
const VERSION: u32 = 1;
/// What the files say of themselves.
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
    /// The file is something else.
    #[error("is no report of a run: name files that `imrs run CELL --node NAME --report FILE` wrote")]
    NoReport,
    /// The file has another version.
    #[error(
        "is a report of version {0}, and this program reads version {VERSION}: use the version of imrs that wrote it"
    )]
    Version(u32),
    /// The report is damaged.
    #[error("is damaged: {0}: copy it again from its machine")]
    Damaged(serde_json::Error),
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

impl Report {
    /// The text of the file.
    #[must_use]
    pub fn text(&self, loaded: &Loaded) -> String {
        let [(_, declarations), (_, statements)] = digests(loaded);
        let head = Head { format: FORMAT.into(), version: VERSION };
        // All keys are texts and all numbers are finite, so nothing can fail.
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
            // A report that was cut off begins as a report.
            Err(error) if text.starts_with(&format!("{{\"format\":\"{FORMAT}\"")) => {
                return Err(ReportError::Damaged(error));
            }
            Err(_) => return Err(ReportError::NoReport),
        };
        if head.format != FORMAT {
            return Err(ReportError::NoReport);
        }
        if head.version != VERSION {
            return Err(ReportError::Version(head.version));
        }
        let file: File<Self> = serde_json::from_str(text).map_err(ReportError::Damaged)?;
        for ((what, ours), theirs) in digests(loaded).into_iter().zip([file.declarations, file.statements]) {
            if ours != theirs {
                return Err(ReportError::OtherCell { what, theirs, ours });
            }
        }
        Ok(file.report)
    }
}
