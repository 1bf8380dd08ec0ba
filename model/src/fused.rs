//! Counts the fused steps that were compared with the small steps that they replace (D176, D193), and compares nodes.

use imrs_protocol::{CellTable, Node, Request, Usage};
use std::sync::atomic::{AtomicU64, Ordering};

static COMPARED: [AtomicU64; 8] = [const { AtomicU64::new(0) }; 8];

/// How many fused steps this process has compared so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    /// The number of messages to a task of the same node.
    pub messages: u64,
    /// The number of answers to messages of a task of the same node.
    pub answers: u64,
    /// The number of arrivals at a `waitfor` whose members are all on one node.
    pub arrivals: u64,
    /// The number of arrivals of the last member, by which all members of a `waitfor` on one node were released.
    pub meetings: u64,
    /// The number of GETs of a task that no handler could interrupt.
    pub gets: u64,
    /// The number of answers that were compared together with the GET that the task makes next.
    pub pairs: u64,
    /// The number of messages to a task of the same node that were queries.
    pub queries: u64,
    /// The number of answers to a task of the same node that were responses to queries.
    pub responses: u64,
}

impl Compared {
    /// The kind of fused step that was compared least often, in the plural, and how often. Queries count as messages,
    /// and responses as answers, because no claim has a query within a node.
    #[must_use]
    pub fn rarest(&self) -> (&'static str, u64) {
        let Self { messages, answers, arrivals, meetings, gets, pairs, .. } = *self;
        let kinds = [
            ("messages", messages),
            ("answers", answers),
            ("arrivals", arrivals),
            ("meetings", meetings),
            ("GETs", gets),
            ("pairs of answer and GET", pairs),
        ];
        kinds.into_iter().min_by_key(|(_, times)| *times).unwrap_or_default()
    }
}

/// How many fused steps this process has compared so far.
#[must_use]
pub fn compared() -> Compared {
    let [messages, answers, arrivals, meetings, gets, pairs, queries, responses] =
        [0, 1, 2, 3, 4, 5, 6, 7].map(|kind: usize| COMPARED[kind].load(Ordering::Relaxed));
    Compared { messages, answers, arrivals, meetings, gets, pairs, queries, responses }
}

/// Counts a fused step for this request. `meets`: the step released the members of a `waitfor`.
pub(crate) fn count(table: &CellTable, request: &Request, meets: bool) {
    let (kind, port, asks) = match request {
        Request::Send { port, .. } => (0, Some(*port), 6),
        Request::Reply { to, .. } => (1, Some(to.port), 7),
        Request::Get { .. } => (4, None, 0),
        _ => (2, None, 0),
    };
    COMPARED[kind].fetch_add(1, Ordering::Relaxed);
    COMPARED[3].fetch_add(u64::from(meets), Ordering::Relaxed);
    let usage = port.and_then(|port| Some(table.port(port)?.decl.usage));
    let is_query = matches!(usage, Some(Usage::Query | Usage::Response));
    COMPARED[asks].fetch_add(u64::from(is_query), Ordering::Relaxed);
}

/// Counts an answer and a GET that were compared together.
pub(crate) fn count_pair() {
    COMPARED[5].fetch_add(1, Ordering::Relaxed);
}

/// Whether a request may have a fused step.
pub(crate) const fn may_have(request: &Request) -> bool {
    matches!(
        request,
        Request::Send { .. } | Request::Reply { .. } | Request::Arrive { .. } | Request::Get { .. }
    )
}

/// Whether the tasks of two copies of a node are in the same state. The packed state has neither the tasks' counters nor
/// the ready set, which is rebuilt when a state is read.
pub(crate) fn are_same(one: &Node, other: &Node) -> bool {
    one.parts().tasks.iter().zip(&other.parts().tasks).all(|(one, other)| one.is_same(other))
}
