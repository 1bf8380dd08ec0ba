//! Events of scripts, as the launcher, its event log and the explanations of the demos use them.

use imrs_protocol::{CellTable, PortId, TaskId};
use serde::{Deserialize, Serialize};

/// An event of a script.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Did {
    /// The instant of the event, in microseconds of the boot-time clock that all processes of one machine share.
    pub at: u64,
    /// The task whose script acted.
    pub task: TaskId,
    /// The line of the statement in the cell file.
    pub line: Option<usize>,
    /// What the script did.
    pub what: ScriptEvent,
}

/// An act of a script, or an event at it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScriptEvent {
    /// The task arrived at a waitfor (a rendezvous).
    Waits(PortId),
    /// A waitfor (a rendezvous) released the task, because all members had arrived.
    Met(PortId),
    /// The task gave up at a waitfor (a rendezvous), because its time_out ended.
    GaveUp {
        /// The port of the waitfor.
        port: PortId,
        /// The tasks that had not arrived.
        missing: Vec<TaskId>,
    },
    /// The script sends a message.
    Sends(PortId),
    /// A class-2 message or a query ended without a reply.
    Unanswered {
        /// The message's port.
        port: PortId,
        /// Why the message was not answered.
        how: Unanswered,
    },
    /// An action begins.
    Begins {
        /// The action's name.
        action: String,
        /// The action's arguments, as text.
        arguments: Vec<String>,
    },
    /// An action succeeded.
    Ends {
        /// The action's name.
        action: String,
        /// The action's result, if it has one.
        value: Option<String>,
    },
    /// An action has failed.
    Fails(String),
    /// An action was cut short.
    CutShort(String),
    /// The task's lease was granted or lost.
    Lease(Lease),
    /// The script has ended.
    Ended(String),
}

/// Why a class-2 message or a query was not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unanswered {
    /// The message was refused, because there was no room.
    Refused,
    /// The request timed out before any copy left the node.
    NeverLeft,
    /// The request timed out after a copy left the node: it may have run.
    Unknown,
    /// The receiver's node restarted before it answered: the request may have run.
    PeerRestarted,
}

/// A change of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lease {
    /// The task may act.
    Granted,
    /// The task takes over from its partner.
    TookOver,
    /// The task may not act any more.
    Fenced,
}

impl ScriptEvent {
    /// Whether the timeline shows the event even if the task has more events than the timeline shows.
    pub const fn is_rare(&self) -> bool {
        matches!(self, Self::Lease(_) | Self::Ended(_))
    }

    /// The event as text for people.
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
            Self::PeerRestarted => "had no answer: the peer stopped or restarted, and it may have run",
        }
    }
}
