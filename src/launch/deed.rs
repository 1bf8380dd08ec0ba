//! What a script does, as the launcher, its diary and the stories of the demos know it.

use imrs_protocol::{CellTable, PortId, TaskId};
use serde::{Deserialize, Serialize};

/// Something that a script did.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Did {
    /// When, on the monotonic clock that all processes of one machine share, in microseconds.
    pub at: u64,
    /// The task.
    pub task: TaskId,
    /// The line of the cell's text.
    pub line: Option<usize>,
    /// What.
    pub what: Deed,
}

/// What a script did.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Deed {
    /// It arrived at a waitfor.
    Waits(PortId),
    /// All have arrived there: it goes on.
    Met(PortId),
    /// Its time_out at a waitfor ended.
    GaveUp {
        /// The port.
        port: PortId,
        /// Who had not arrived.
        missing: Vec<TaskId>,
    },
    /// It sends a message.
    Sends(PortId),
    /// A message of class 2 or a query had no good end.
    Unanswered {
        /// Its port.
        port: PortId,
        /// How it ended.
        how: Unanswered,
    },
    /// An action begins.
    Begins {
        /// Its name.
        action: String,
        /// Its arguments, as a person writes them.
        arguments: Vec<String>,
    },
    /// An action has ended well.
    Ends {
        /// Its name.
        action: String,
        /// Its result, where it has one.
        value: Option<String>,
    },
    /// An action has failed.
    Fails(String),
    /// An action was cut short.
    CutShort(String),
    /// The lease of its couple came or went.
    Lease(Lease),
    /// It has ended.
    Ended(String),
}

/// Why there was no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unanswered {
    /// Refused for space.
    Refused,
    /// Timed out before any copy left.
    NeverLeft,
    /// Timed out; it may have run.
    Unknown,
    /// The peer restarted; it may have run.
    PeerRestarted,
}

/// What became of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lease {
    /// The task may act.
    Granted,
    /// The task takes over from its partner.
    TookOver,
    /// The task may act no more.
    Fenced,
}

impl Deed {
    /// Whether it is told however busy the task is.
    pub const fn is_rare(&self) -> bool {
        matches!(self, Self::Lease(_) | Self::Ended(_))
    }

    /// What a person reads.
    pub fn words(&self, table: &CellTable) -> String {
        let port = |port: &PortId| table.port(*port).map_or("?", |port| port.decl.name.as_str());
        match self {
            Self::Waits(at) => format!("waits at `{}`", port(at)),
            Self::Met(at) => format!("all arrived at `{}`", port(at)),
            Self::GaveUp { port: at, missing } => {
                let name = |task: &TaskId| table.cell().tasks.get(task.index()).map_or("?", |t| &t.name);
                let names: Vec<&str> = missing.iter().map(name).collect();
                format!("TIME_OUT at `{}`: {} missing", port(at), names.join(", "))
            }
            Self::Sends(at) => format!("sends `{}`", port(at)),
            Self::Unanswered { port: at, how } => format!("`{}` {}", port(at), how.words()),
            Self::Begins { action, arguments } if arguments.is_empty() => format!("begins {action}"),
            Self::Begins { action, arguments } => format!("begins {action} {}", arguments.join(", ")),
            Self::Ends { action, value: None } => format!("ends {action}"),
            Self::Ends { action, value: Some(value) } => format!("ends {action}: {value}"),
            Self::Fails(action) => format!("FAILED: {action}"),
            Self::CutShort(action) => format!("{action} is cut short"),
            Self::Lease(Lease::Granted) => "holds the lease: it is active".into(),
            Self::Lease(Lease::TookOver) => "TAKES OVER: it is active now".into(),
            Self::Lease(Lease::Fenced) => "has lost the lease: it acts no more".into(),
            Self::Ended(how) => how.clone(),
        }
    }
}

impl Unanswered {
    const fn words(self) -> &'static str {
        match self {
            Self::Refused => "was refused for space",
            Self::NeverLeft => "TIME_OUT: it never left",
            Self::Unknown => "TIME_OUT: it may have run",
            Self::PeerRestarted => "had no answer: the peer restarted, and it may have run",
        }
    }
}
