//! Which frames of a recording show that something went wrong, and how grave it is.

use crate::clock::Moment;
use crate::conformance::Verdict;
use crate::source::SourceId;
use crate::store::conformance::conformance;
use crate::store::cuts::cuts;
use crate::store::journal::{Severity, level_of};
use crate::store::{Condition, IncarnationId, Presence, Store};
use imrs_protocol::TaskId;
use imrs_wire::obs::{Events, Liveness, ServerFrame};
use imrs_wire::recording::Shown;
use std::collections::BTreeSet;
use std::time::Duration;

/// How grave it is what went wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trouble {
    /// Nothing went wrong.
    #[default]
    None,
    /// A message or a wait timed out, or the like. In an overloaded cell this occurs all the time.
    Slight,
    /// A node died or fell silent, a task crashed, a link was cut, or a node did what the model does not allow. In a
    /// counterexample: a fault, or the finding.
    Grave,
}

/// A grave fault that lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    Crashed(IncarnationId, TaskId),
    Silent(IncarnationId),
    Cut(IncarnationId, IncarnationId),
    Violates(IncarnationId),
}

/// The faults are searched at most this often, because the search looks at all nodes.
const APART: Duration = Duration::from_millis(100);

/// The grave faults at the last search.
#[derive(Clone, Debug, Default)]
pub(crate) struct Troubles {
    known: BTreeSet<Fault>,
    looked: Option<Moment>,
}

impl Troubles {
    /// What goes wrong in a frame that arrives from `source` at the moment `at`. `before` is the store before the frame, so
    /// a fault that only the store shows is noticed with the next frame.
    pub(crate) fn of(&mut self, shown: &Shown, source: SourceId, at: Moment, before: &Store) -> Trouble {
        let own = match shown {
            Shown::Lost { .. } => {
                let incarnation = before.incarnation_of(source);
                let has_stopped =
                    incarnation.is_some_and(|one| matches!(one.condition, Condition::Stopped { .. }));
                if has_stopped { Trouble::None } else { Trouble::Grave }
            }
            Shown::Said(ServerFrame::Events(Events { events, .. }))
                if events.iter().any(|event| level_of(event.what.event) == Severity::Bad) =>
            {
                Trouble::Slight
            }
            Shown::Said(_) | Shown::Attached { .. } | Shown::Story(_) | Shown::Step(_) => Trouble::None,
        };
        if self.looked.is_some_and(|looked| at.saturating_sub(looked) < APART) {
            return own;
        }
        self.looked = Some(at);
        let now = faults(before, at);
        let is_new = !now.is_subset(&self.known);
        self.known = now;
        if is_new { Trouble::Grave } else { own }
    }
}

/// The grave faults at a moment.
fn faults(store: &Store, now: Moment) -> BTreeSet<Fault> {
    let mut found = BTreeSet::new();
    let present = || store.incarnations().iter().filter(|one| store.is_present(one));
    for one in present() {
        match one.presence(now) {
            Presence::Silent(_) => drop(found.insert(Fault::Silent(one.id))),
            Presence::Up => {
                let crashed = one.tasks().iter().filter(|task| task.liveness == Liveness::Crashed);
                found.extend(crashed.map(|task| Fault::Crashed(one.id, task.view.task)));
            }
            Presence::Stopped(_) | Presence::Dead(_) => {}
        }
        if matches!(conformance(store, one.id).verdict, Verdict::Violates { .. }) {
            found.insert(Fault::Violates(one.id));
        }
    }
    let cells: BTreeSet<_> = present().map(|one| &one.names.cell).collect();
    for cell in cells {
        found.extend(cuts(store, cell, now).iter().map(|cut| Fault::Cut(cut.from.id, cut.to.id)));
    }
    found
}
