//! Counts the fused steps that were compared with the small steps that they replace (D176, D193), and compares nodes.

use imrs_protocol::{Node, Request};
use std::sync::atomic::{AtomicU64, Ordering};

static COMPARED: [AtomicU64; 6] = [const { AtomicU64::new(0) }; 6];

/// How many fused steps this process has compared so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    /// The number of messages to a task of the same node.
    pub messages: u64,
    /// The number of answers to such messages.
    pub answers: u64,
    /// The number of arrivals at a `waitfor` whose members are all on one node.
    pub arrivals: u64,
    /// The number of these arrivals that were the last member's, so that all members were released.
    pub meetings: u64,
    /// GETs of a task that no handler could interrupt.
    pub gets: u64,
    /// Answers, each with the GET that the task makes next.
    pub pairs: u64,
}

/// How many fused steps this process has compared so far.
#[must_use]
pub fn compared() -> Compared {
    let [messages, answers, arrivals, meetings, gets, pairs] =
        [0, 1, 2, 3, 4, 5].map(|kind: usize| COMPARED[kind].load(Ordering::Relaxed));
    Compared { messages, answers, arrivals, meetings, gets, pairs }
}

/// Counts a fused step for this request. `meets`: the step released the members of a `waitfor`.
pub(crate) fn count(request: &Request, meets: bool) {
    let kind = match request {
        Request::Send { .. } => 0,
        Request::Reply { .. } => 1,
        Request::Get { .. } => 4,
        _ => 2,
    };
    COMPARED[kind].fetch_add(1, Ordering::Relaxed);
    COMPARED[3].fetch_add(u64::from(meets), Ordering::Relaxed);
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
