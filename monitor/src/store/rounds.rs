//! The history of each rendezvous (§4.3), from the events of its members: arrivals, releases and give-ups in each round.

use super::Store;
use super::service::percentile;
use crate::clock::{Moment, micros};
use crate::name::Name;
use imrs_protocol::{Event, PortId, TaskId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// How many rounds of a rendezvous are kept.
pub const KEPT: usize = 50;

/// How a round ended for one member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The member was released.
    Released,
    /// The member gave up.
    GaveUp,
    /// The member left for a newer round.
    Left,
}

/// How a round ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Not all members that arrived have left the round.
    Open,
    /// All members that arrived were released.
    Done,
    /// All members that arrived gave up or left.
    InVain,
    /// Some members were released and others were not.
    Divergent,
}

/// One round of a rendezvous.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Round {
    /// The number of the round.
    pub number: u32,
    /// The members that arrived, in the order of their reports, each with the moment of its arrival on the monitor's clock.
    pub came: Vec<(TaskId, Moment)>,
    /// How the round ended for each member that has left it.
    pub ended: Vec<(TaskId, End)>,
    /// The moment of the round's last event.
    pub last: Moment,
}

impl Round {
    /// How the round ended.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        let went_on = self.ended.iter().any(|(_, end)| *end == End::Released);
        let stayed = self.ended.iter().any(|(_, end)| *end != End::Released);
        match (went_on, stayed) {
            (true, true) => Outcome::Divergent,
            _ if self.ended.len() < self.came.len() || self.ended.is_empty() => Outcome::Open,
            (true, false) => Outcome::Done,
            (false, _) => Outcome::InVain,
        }
    }

    /// The member that arrived last, and the time since the first arrival. Between nodes this time is only as exact as
    /// the monitor's connections.
    #[must_use]
    pub fn gathered(&self) -> Option<(TaskId, Moment)> {
        let first = self.came.iter().map(|(_, at)| *at).min()?;
        let (last, at) = self.came.iter().max_by_key(|(_, at)| *at)?;
        Some((*last, at.saturating_sub(first)))
    }

    fn end(&mut self, task: TaskId, end: End) {
        if !self.ended.iter().any(|(of, _)| *of == task) {
            self.ended.push((task, end));
        }
    }
}

/// The last rounds of a rendezvous.
#[derive(Clone, Debug, Default)]
pub struct History {
    rounds: VecDeque<Round>,
}

/// The statistics of a rendezvous.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// How many rounds released all members that arrived.
    pub done: usize,
    /// In how many rounds all members gave up or left.
    pub in_vain: usize,
    /// In how many rounds some members were released and others were not.
    pub divergent: usize,
    /// The median time from the first arrival to the last, in microseconds; only of rounds in which all members arrived.
    pub gather_p50_us: Option<u64>,
    /// The 99th percentile of the time from the first arrival to the last, in microseconds.
    pub gather_p99_us: Option<u64>,
    /// The member that most often arrived last, and in what percentage of the rounds it did.
    pub slowest: Option<(TaskId, usize)>,
}

impl History {
    /// The last rounds, oldest first.
    pub fn rounds(&self) -> impl DoubleEndedIterator<Item = &Round> {
        self.rounds.iter()
    }

    /// Computes the statistics. `members` is the number of members; a round with fewer arrivals has no gather time.
    #[must_use]
    pub fn summary(&self, members: usize) -> Summary {
        let count = |outcome| self.rounds.iter().filter(|r| r.outcome() == outcome).count();
        let full = self.rounds.iter().filter(|round| round.came.len() == members);
        let gathered: Vec<(TaskId, Moment)> = full.filter_map(Round::gathered).collect();
        let mut times: Vec<u64> = gathered.iter().map(|(_, time)| micros(*time)).collect();
        let mut last: BTreeMap<TaskId, usize> = BTreeMap::new();
        for (task, _) in &gathered {
            *last.entry(*task).or_default() += 1;
        }
        let slowest = last.into_iter().max_by_key(|(_, times)| *times);
        Summary {
            done: count(Outcome::Done),
            in_vain: count(Outcome::InVain),
            divergent: count(Outcome::Divergent),
            gather_p50_us: percentile(&mut times, 50),
            gather_p99_us: percentile(&mut times, 99),
            slowest: slowest.map(|(task, times)| (task, times * 100 / gathered.len().max(1))),
        }
    }

    fn round(&mut self, number: u32) -> &mut Round {
        let at = self.rounds.iter().rposition(|round| round.number == number);
        let at = at.unwrap_or_else(|| {
            if self.rounds.len() == KEPT {
                self.rounds.pop_front();
            }
            self.rounds.push_back(Round { number, ..Round::default() });
            self.rounds.len() - 1
        });
        &mut self.rounds[at]
    }

    fn came(&mut self, task: TaskId, number: u32, at: Moment) {
        let round = self.round(number);
        if !round.came.iter().any(|(of, _)| *of == task) {
            round.came.push((task, at));
        }
    }
}

/// The observed rounds of the rendezvous on a port.
#[must_use]
pub fn history<'s>(store: &'s Store, cell: &Name, port: PortId) -> Option<&'s History> {
    store.histories.of.get(&(cell.clone(), port)).map(AsRef::as_ref)
}

/// The histories of all rendezvous.
#[derive(Clone, Debug, Default)]
pub(super) struct Histories {
    of: BTreeMap<(Name, PortId), Arc<History>>,
}

impl Histories {
    /// Updates the histories with an event of a task.
    pub fn happened(
        &mut self,
        cell: &Name,
        task: TaskId,
        at: Moment,
        event: Event,
        (port, number): (PortId, u32),
    ) {
        let end = match event {
            Event::Reached | Event::Rejoined => None,
            Event::ReleasedComplete | Event::ReleasedByConfirm => Some(End::Released),
            Event::GaveUp => Some(End::GaveUp),
            _ => return,
        };
        let history = Arc::make_mut(self.of.entry((cell.clone(), port)).or_default());
        if event == Event::Rejoined {
            // The member leaves the round in which it has waited until now.
            let waits = |round: &&mut Round| {
                round.came.iter().any(|(of, _)| *of == task) && !round.ended.iter().any(|(of, _)| *of == task)
            };
            if let Some(left) =
                history.rounds.iter_mut().filter(|round| round.number != number).rev().find(waits)
            {
                left.end(task, End::Left);
            }
        }
        history.round(number).last = at;
        match end {
            None => history.came(task, number, at),
            // A member whose arrival was not observed does not count for the gather time.
            Some(end) => history.round(number).end(task, end),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const LIFT: PortId = PortId(0);

    fn told(list: &[(u64, u16, Event, u32)]) -> History {
        let mut histories = Histories::default();
        let cell = Name::new("cell");
        for &(ms, task, event, round) in list {
            histories.happened(&cell, TaskId(task), Duration::from_millis(ms), event, (LIFT, round));
        }
        histories.of[&(cell, LIFT)].as_ref().clone()
    }

    #[test]
    fn rounds_end_done_in_vain_or_divergent() {
        let history = told(&[
            (0, 0, Event::Reached, 1),
            (30, 1, Event::Reached, 1),
            (31, 1, Event::ReleasedComplete, 1),
            (32, 0, Event::ReleasedByConfirm, 1),
            (40, 0, Event::Reached, 2),
            (90, 0, Event::GaveUp, 2),
            (100, 0, Event::Reached, 3),
            (110, 1, Event::Reached, 3),
            (111, 0, Event::ReleasedComplete, 3),
            (200, 1, Event::GaveUp, 3),
            (300, 0, Event::Reached, 4),
        ]);
        let outcomes: Vec<_> = history.rounds().map(Round::outcome).collect();
        assert_eq!(outcomes, [Outcome::Done, Outcome::InVain, Outcome::Divergent, Outcome::Open]);
        let summary = history.summary(2);
        assert_eq!((summary.done, summary.in_vain, summary.divergent), (1, 1, 1));
        assert_eq!((summary.gather_p50_us, summary.gather_p99_us), (Some(10_000), Some(30_000)));
        assert_eq!(summary.slowest, Some((TaskId(1), 100)));
    }

    #[test]
    fn who_goes_on_to_a_fresher_round_has_left_its_own() {
        let history = told(&[
            (0, 0, Event::Reached, 7),
            (5, 0, Event::Rejoined, 9),
            (6, 0, Event::ReleasedComplete, 9),
        ]);
        let rounds: Vec<_> = history.rounds().map(|round| (round.number, round.outcome())).collect();
        assert_eq!(rounds, [(7, Outcome::InVain), (9, Outcome::Done)]);
    }

    #[test]
    fn only_the_last_rounds_are_kept() {
        let list: Vec<_> = (0..60).map(|n| (u64::from(n), 0, Event::Reached, n)).collect();
        let history = told(&list);
        assert_eq!(history.rounds().count(), KEPT);
        assert_eq!(history.rounds().next().map(|round| round.number), Some(10));
    }
}
