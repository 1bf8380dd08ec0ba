//! Findings between tasks: rendezvous that will fail or have failed for some members, and wait-for cycles.

use super::{Finding, Place, codes};
use crate::clock::Moment;
use crate::name::Name;
use crate::store::meeting::{Meeting, Member, Standing, meetings};
use crate::store::rounds::{Outcome, history};
use crate::store::waits::cycles;
use crate::store::{Names, Store};
use imrs_protocol::TaskId;
use std::time::Duration;

/// For how long a divergent round is reported.
const TOLD: Duration = Duration::from_secs(10);

pub(super) fn look(store: &Store, cell: &Name, now: Moment, found: &mut Vec<Finding>) {
    let Some(names) = store.names(cell) else { return };
    for one in meetings(store, cell, now) {
        waiting(store, cell, names, &one, found);
        divergent(store, cell, names, &one, now, found);
    }
    for cycle in cycles(store, cell, now) {
        let Some(place) = cycle.tasks.first().and_then(|task| home(store, cell, names, *task)) else {
            continue;
        };
        let text = format!("wait-for cycle: {}", cycle.why.join(", "));
        found.push(Finding::new(&codes::WAIT_CYCLE, place, text));
    }
}

/// The place of a task in the latest incarnation of its node.
fn home(store: &Store, cell: &Name, names: &Names, task: TaskId) -> Option<Place> {
    let incarnation = names.home(task).and_then(|node| store.latest(cell, node))?;
    Some(Place { task: Some(task), ..Place::node(incarnation) })
}

/// The findings of a rendezvous in which a member waits.
fn waiting(store: &Store, cell: &Name, names: &Names, meeting: &Meeting, found: &mut Vec<Finding>) {
    let title = |m: &Member| format!("{}@{}", m.name, m.node);
    let lost: Vec<String> = meeting.lost().map(title).collect();
    let missing =
        meeting.members.iter().filter(|m| matches!(m.standing, Standing::Missing | Standing::Unknown));
    let missing: Vec<String> = missing
        .map(|m| if m.doing.is_empty() { title(m) } else { format!("{} ({})", title(m), m.doing) })
        .collect();
    for member in meeting.members.iter().filter(|m| !m.is_gone() && !m.waits_for.is_empty()) {
        let Some(place) = home(store, cell, names, member.task) else { continue };
        let place = Place { port: Some(meeting.port), ..place };
        let patience = member.left.zip(member.waited_us);
        let spent = patience.is_some_and(|(left, waited)| left.us < waited.saturating_add(left.us) / 4);
        if !lost.is_empty() {
            let text = format!("lost {}: waits in vain", lost.join(", "));
            found.push(Finding::new(&codes::LOST_MEMBER, place, text));
        } else if member.within_margin {
            let text = "a CONFIRM is missing: all arrived, too late to go on alone".to_owned();
            found.push(Finding::new(&codes::WITHIN_MARGIN, place, text));
        } else if spent && !missing.is_empty() {
            let left = member.left.map_or_else(String::new, |left| format!(", {left} left"));
            let text = format!("stuck{left}: missing {}", missing.join(", "));
            found.push(Finding::new(&codes::RENDEZVOUS_STUCK, place, text));
        }
    }
}

/// Reports a recent divergent round: some members were released and others were not.
fn divergent(
    store: &Store,
    cell: &Name,
    names: &Names,
    meeting: &Meeting,
    now: Moment,
    found: &mut Vec<Finding>,
) {
    let Some(history) = history(store, cell, meeting.port) else { return };
    let recent = |at: Moment| now.saturating_sub(at) <= TOLD;
    let round = history.rounds().rev().find(|r| r.outcome() == Outcome::Divergent && recent(r.last));
    let Some(round) = round else { return };
    let ended = |released: bool| {
        let of = round
            .ended
            .iter()
            .filter(move |(_, end)| (*end == crate::store::rounds::End::Released) == released);
        of.map(|(task, _)| names.task(*task).to_string()).collect::<Vec<_>>().join(", ")
    };
    let Some((first, _)) = round.ended.first() else { return };
    let Some(place) = home(store, cell, names, *first) else { return };
    let text = format!("round {}: {} went on, {} did not", round.number, ended(true), ended(false));
    found.push(Finding::new(&codes::DIVERGENT, Place { port: Some(meeting.port), ..place }, text));
}
