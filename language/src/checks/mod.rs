//! Static checks of a cell (the paper's "compiler"): each finding stands on the line that causes it. If a check cannot
//! decide a case, it reports nothing, because the model checker tries that case.

mod answers;
mod couples;
mod deadlines;
pub(crate) mod flow;
mod meetings;
mod messages;
mod paper;
mod ranks;
mod ring;
mod times;
mod unanswered;
mod unused;
mod work;

pub(crate) use deadlines::least as least_time_out;
pub(crate) use messages::{carries_heartbeats, starters};
pub(crate) use paper::paper;

use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Task};
use imrs_protocol::TaskId;

/// The least time_out in ticks. A shorter time_out can be used up by the lateness of timers alone (D42).
const LEAST_TICKS: u64 = 4;

/// All findings in a cell whose names and types are right, in the order of the text. With `paper`, a `waitfor` needs no
/// branch for its time_out, as in the paper (D2).
pub(crate) fn all(hir: &Hir, paper: bool) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    meetings::check(hir, paper, &mut found);
    messages::check(hir, paper, &mut found);
    answers::check(hir, &mut found);
    ranks::check(hir, &mut found);
    flow::check(hir, &mut found);
    times::check(hir, &mut found);
    deadlines::check(hir, &mut found);
    couples::check(hir, &mut found);
    unused::check(hir, &mut found);
    found.sort_by_key(|diagnostic| (diagnostic.primary.span, diagnostic.code));
    found
}

/// Whether a task has no statements and handlers yet. Of such a task, only the declarations are checked.
fn is_draft(task: &Task) -> bool {
    !task.is_extern && task.body.is_empty() && task.handlers.is_empty() && task.takeover.is_none()
}

fn task(hir: &Hir, id: TaskId) -> &Task {
    &hir.tasks[id.index()]
}

fn tasks(hir: &Hir) -> impl Iterator<Item = (TaskId, &Task)> {
    hir.tasks.iter().enumerate().map(|(at, task)| (TaskId::from_index(at), task))
}

/// A duration as text, in its largest whole unit.
fn time(usec: u64) -> String {
    if usec.is_multiple_of(1_000_000) && usec > 0 {
        format!("{} sec", usec / 1_000_000)
    } else if usec.is_multiple_of(1_000) {
        format!("{} msec", usec / 1_000)
    } else {
        format!("{usec} usec")
    }
}
