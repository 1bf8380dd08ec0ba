//! Compares a node's state with its previous one.

use super::Store;
use super::incarnation::Notable;
use super::journal::{Entry, Severity, What};
use crate::clock::Moment;
use imrs_protocol::TaskId;
use imrs_wire::obs::{Count, Liveness};

impl Store {
    /// Adds journal entries for changes that no state machine observes: ended tasks and drops on links.
    pub(super) fn compare(&mut self, at: Moment, index: usize, before: Option<Notable>) {
        let (Some(before), Some(after)) = (before, self.incarnations[index].last.clone()) else { return };
        let after = &after.snapshot;
        let mut found = Vec::new();
        let was = |id: TaskId| before.tasks.iter().find(|(task, _)| *task == id).map(|(_, was)| *was);
        for task in &after.tasks {
            // Tasks that still run have nothing to report here.
            if task.liveness == Liveness::Alive {
                continue;
            }
            let name = self.incarnations[index].names.task(task.view.task).to_string();
            match (was(task.view.task), task.liveness) {
                (Some(Liveness::Alive), Liveness::Crashed) => {
                    found.push((Severity::Bad, "crashed", name, "the task panicked".to_owned(), 1));
                }
                (Some(Liveness::Alive), Liveness::Ended) => {
                    found.push((Severity::Note, "ended", name, "the task returned".to_owned(), 1));
                }
                _ => {}
            }
        }
        let old = |name: &str| before.link_discards.iter().find(|c| c.name == name).map_or(0, |c| c.count);
        for Count { name, count } in &after.link_discards {
            let more = count.saturating_sub(old(name));
            if more > 0 {
                let object = "on a link".to_owned();
                found.push((Severity::Warn, "discard", object, crate::name::shown(name), more));
            }
        }
        let incarnation = &self.incarnations[index];
        for (level, kind, object, detail, times) in found {
            let what = What::Noticed { level, kind, object, detail };
            self.journal.add(Entry::new(at, incarnation, what, times));
        }
    }
}
