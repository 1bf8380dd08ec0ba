//! The facts of a run, and the trait of the folds, which compute results from the facts.

use crate::checks::Broken;
use crate::faults::Fault;
use crate::pipe::Word;
use imrs_protocol::{NodeId, TaskId};
use imrs_runtime::guard::Notice;

/// Something that the launcher did or learnt. The report of a node is kept in the form in which it came.
#[derive(Debug)]
pub enum Fact {
    /// The nodes get their addresses, and the run begins.
    Began,
    /// A node has reported something.
    Said(NodeId, Word),
    /// A fault was injected.
    Fault(Fault),
    /// A node is dead, and the launcher did not kill it.
    Died(NodeId),
    /// The pipe of a node's current incarnation has ended: it reports nothing more.
    Gone(NodeId),
    /// The launcher ends before this node has reported everything.
    Unheard(NodeId),
    /// A node or a guard has reported something about the command of an action.
    Noticed(Notice),
    /// A check of the cell does not hold.
    Broken(Broken),
    /// The only tasks that still run serve for ever.
    Idle(Vec<TaskId>),
    /// The run is over. The nodes are stopped from now on.
    Over,
}

/// Computes a result from the facts of a run. It takes each fact, in the order in which the launcher learnt them, and
/// keeps only what its result needs.
pub trait Fold {
    /// Takes a fact. `at` is its instant, in microseconds of the clock that all processes of one machine share.
    fn take(&mut self, at: u64, fact: &Fact);
}
