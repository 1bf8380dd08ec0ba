//! In which rounds of a waitfor each member took part. Machines share no clock, so their reports have sets of round
//! numbers instead of events with times. The sets of all members together give the outcomes of the rounds.

use super::rounds::{Rounds, Wide};
use super::settled::falsely;
use super::spans::Spans;
use crate::pipe::{Event, What};
use imrs_protocol::{CellTable, NodeId, Port, PortId, TaskId, Usage};
use serde::{Deserialize, Serialize};

/// The most ranges that are kept of each set. If a set has more, the oldest rounds of the report are forgotten.
const RANGES: usize = 4_096;
/// When its node starts, a member counts its rounds from 0. The numbers wrap around at this number.
const WRAP: i64 = 1 << 16;
/// By how many wraps the counts of two members may differ at most: a month of ten rounds a second.
const MOST_WRAPS: i64 = 400;

/// The rounds of a waitfor in which a member took part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attended {
    /// The port of the waitfor (a rendezvous of tasks).
    pub port: PortId,
    /// The member.
    pub task: TaskId,
    /// The rounds that the member announced: it said that it had arrived.
    pub announced: Spans,
    /// The rounds that released the member.
    pub released: Spans,
    /// The rounds that the member gave up.
    pub gave_up: Spans,
    /// The last round that was forgotten, because a set had too many ranges. All earlier rounds were forgotten, too.
    pub forgotten: Option<i64>,
    /// Whether events of the member are missing.
    pub is_partial: bool,
}

impl Attended {
    const fn sets(&self) -> [&Spans; 3] {
        [&self.announced, &self.released, &self.gave_up]
    }

    fn add(&mut self, round: i64, what: What) {
        match what {
            What::Announced => self.announced.add(round),
            What::Released => self.released.add(round),
            What::GaveUp { .. } => self.gave_up.add(round),
        }
        let full = self.sets().into_iter().find(|set| set.pieces() > RANGES);
        if let Some(upto) = full.and_then(Spans::end_of_the_oldest) {
            let sets = [&mut self.announced, &mut self.released, &mut self.gave_up];
            sets.into_iter().for_each(|set| set.forget(upto));
            self.forgotten = Some(upto);
        }
    }

    /// The first and the last round about which this report has complete information.
    fn told(&self) -> Option<(i64, i64)> {
        let ends = self.sets().into_iter().filter_map(Spans::ends);
        let (first, last) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        Some((self.forgotten.map_or(first, |forgotten| first.max(forgotten + 1)), last))
    }

    /// The same rounds, numbered as in `other`: shifted by the number of wraps with which the two sets have the most
    /// rounds in common.
    fn counted_as(&self, other: &Spans) -> Self {
        let common = |&wraps: &i64| (self.released.shifted(wraps * WRAP).common(other), -wraps.abs());
        let wraps = self.released.ends().zip(other.ends()).and_then(|((first, last), (from, to))| {
            let most = |apart: i64| (apart / WRAP).clamp(-MOST_WRAPS, MOST_WRAPS);
            (most(from.saturating_sub(last))..=most(to.saturating_sub(first))).max_by_key(common)
        });
        let by = wraps.unwrap_or(0) * WRAP;
        let [announced, released, gave_up] = self.sets().map(|set| set.shifted(by));
        let forgotten = self.forgotten.map(|round| round + by);
        Self { announced, released, gave_up, forgotten, ..*self }
    }
}

/// Collects the rounds of the members whose nodes report to this launcher.
pub struct Attendance(Vec<(Attended, Wide)>);

impl Attendance {
    /// Makes the empty sets for the tasks on these nodes.
    pub fn new(table: &CellTable, here: &[NodeId]) -> Self {
        let is_here = |task: TaskId| table.location(task).is_some_and(|node| here.contains(&node));
        let of = |port: &Port| {
            let (port, parties) = (port.id, port.parties.iter().map(|party| party.task));
            parties.filter(|task| is_here(*task)).map(move |task| (port, task)).collect::<Vec<_>>()
        };
        let empty = |(port, task)| (Attended { port, task, ..Attended::default() }, Wide::default());
        Self(waitfors(table).flat_map(of).map(empty).collect())
    }

    /// Takes an event of a member. The events of one member must come in order of time.
    pub fn take(&mut self, event: &Event) {
        let mut members = self.0.iter_mut();
        let is_it = |(of, _): &&mut (Attended, Wide)| of.port == event.port && of.task == event.task;
        if let Some((attended, last)) = members.find(is_it) {
            attended.add(last.count_on(event.round), event.what);
        }
    }

    /// The rounds of each member. `is_partial` says whether events of nodes are missing.
    pub fn told(&self, is_partial: bool) -> Vec<Attended> {
        self.0.iter().map(|(attended, _)| Attended { is_partial, ..attended.clone() }).collect()
    }
}

/// The ports of a cell at which tasks meet (usage `waitfor`).
pub fn waitfors(table: &CellTable) -> impl Iterator<Item = &Port> {
    table.ports().iter().filter(|port| port.decl.usage == Usage::Waitfor)
}

/// The outcomes of the rounds of one waitfor, computed from the reports of its members. A member has one report for
/// each start of its node on each machine.
pub fn outcomes(members: &[TaskId], reports: &[&Attended]) -> Rounds {
    // All rounds are numbered as in the longest report, because a member whose node started later counts from 0
    // again.
    let longest = reports.iter().max_by_key(|report| report.released.common(&report.released));
    let reports: Vec<Attended> = reports
        .iter()
        .map(|report| {
            longest.map_or_else(|| (*report).clone(), |longest| report.counted_as(&longest.released))
        })
        .collect();
    let members: Vec<Member<'_>> = members
        .iter()
        .map(|task| Member(reports.iter().filter(|report| report.task == *task).collect()))
        .collect();
    // From each of these rounds up to the next one, all rounds are in the same sets, and so have the same outcome.
    let mut turns: Vec<i64> = reports.iter().flat_map(turns_of).collect();
    turns.sort_unstable();
    turns.dedup();
    let mut sum = Rounds::default();
    for pair in turns.windows(2) {
        add(&mut sum, &members, pair[0], pair[1].abs_diff(pair[0]));
    }
    sum.rounds = sum.released + sum.timed_out + sum.divergent + sum.unknown;
    sum
}

/// The rounds at which any set of this report begins or ends.
fn turns_of(report: &Attended) -> Vec<i64> {
    let ranges = report.sets().into_iter().flat_map(Spans::ranges).chain(report.told());
    // The last round of a range stands alone: the member may not have gone on to a later round.
    ranges.flat_map(|(first, last)| [first, last, last + 1]).collect()
}

/// The reports of one member.
struct Member<'a>(Vec<&'a Attended>);

impl Member<'_> {
    fn is_in(&self, round: i64, set: impl Fn(&Attended) -> &Spans) -> bool {
        self.0.iter().any(|report| set(report).has(round))
    }

    /// Whether a complete report of this member covers this round, even if the member did not take part in it.
    fn tells(&self, round: i64) -> bool {
        let whole = self.0.iter().filter(|report| !report.is_partial);
        whole.filter_map(|report| report.told()).any(|(first, last)| (first..=last).contains(&round))
    }

    /// Whether the member announced a later round.
    fn went_on(&self, round: i64) -> bool {
        self.0.iter().filter_map(|report| report.announced.ends()).any(|(_, last)| last > round)
    }
}

/// Adds `count` successive rounds, from `round` on, to the sums. All of them have the same outcome.
fn add(sum: &mut Rounds, members: &[Member<'_>], round: i64, count: u64) {
    let set = |is_so: &dyn Fn(&Member<'_>) -> bool| {
        members.iter().enumerate().fold(0, |set, (place, member)| set | u64::from(is_so(member)) << place)
    };
    let all = set(&|_| true);
    let announced = set(&|member| member.is_in(round, |report| &report.announced));
    let released = set(&|member| member.is_in(round, |report| &report.released));
    let gave_up = set(&|member| member.is_in(round, |report| &report.gave_up));
    let silent = set(&|member| !member.tells(round));
    let unreported = set(&|member| member.0.iter().all(|report| report.is_partial));
    sum.false_releases += count * falsely(all & !announced & !silent, released);
    let told = all & !released & !silent;
    let waited = set(&|member| !member.went_on(round)) & announced & !(released | gave_up);
    let outcome = if released == all {
        &mut sum.released
    } else if released == 0 {
        if gave_up != 0 {
            if unreported == 0 { &mut sum.timed_out } else { &mut sum.unknown }
        } else if waited != 0 {
            &mut sum.unfinished
        } else {
            return;
        }
    } else if told == 0 {
        &mut sum.unknown
    } else if told & !waited != 0 {
        &mut sum.divergent
    } else {
        &mut sum.unfinished
    };
    *outcome += count;
}

#[cfg(test)]
mod tests;
