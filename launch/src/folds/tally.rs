//! Counts the outcomes of the rounds of a waitfor (a rendezvous), from the events that its members reported.

use super::rounds::{Rounds, Wide};
use super::settled::{Settled, falsely};
use super::spread::Spreading;
use crate::pipe::{Event, What};
use imrs_protocol::TaskId;
use std::collections::BTreeMap;

/// The greatest number of rounds that are kept one by one. Older rounds are settled without waiting for further events.
const OPEN: usize = 4_096;
/// The rounds of one waitfor. The newest rounds are kept one by one. Older rounds are settled: they are added to the
/// sums and dropped.
#[derive(Clone, Debug)]
pub struct Tally {
    members: Vec<Member>,
    /// The rounds that are not settled yet, by number.
    rounds: BTreeMap<i64, Meeting>,
    /// The greatest number of rounds that are kept unsettled.
    open: usize,
    /// The lowest round that any event named.
    first: Option<i64>,
    settled: Settled,
}

#[derive(Clone, Debug)]
struct Member {
    task: TaskId,
    /// The round of the member's last event.
    last: Wide,
    /// The last round that the member announced: the member said there that it had arrived.
    announced: i64,
    /// The last kill of the member's node. Events from just before the kill did not reach the launcher.
    died: Option<Death>,
    /// Whether some of the member's announcements did not reach the launcher.
    untold: bool,
}

#[derive(Clone, Copy, Debug)]
struct Death {
    at: u64,
    /// The last round that the member had announced before the kill.
    announced: i64,
    /// The newest settled round that began before the kill and released a member.
    released: Option<i64>,
    /// When the member's node was restarted; `None` if it was not.
    revived: Option<u64>,
}

/// The known events of one round. Sets of members are bit masks by position.
#[derive(Clone, Copy, Debug)]
struct Meeting {
    announced: u64,
    released: u64,
    gave_up: u64,
    /// The time of the round's earliest event.
    begun: u64,
    first_start: u64,
    last_start: u64,
}

impl Tally {
    /// Makes the tally of a waitfor of these tasks (at most 64), before any event.
    pub fn new(members: impl IntoIterator<Item = TaskId>) -> Self {
        let member =
            |task| Member { task, last: Wide::default(), announced: i64::MIN, died: None, untold: false };
        let members = members.into_iter().map(member).collect();
        Self { members, rounds: BTreeMap::new(), open: OPEN, first: None, settled: Settled::default() }
    }

    /// Takes an event of a member. The events of one member must come in order of time.
    pub fn take(&mut self, event: &Event) {
        let Some(place) = self.place(event.task) else { return };
        let member = &mut self.members[place];
        let round = member.last.count_on(event.round);
        if event.what == What::Announced {
            member.announced = member.announced.max(round);
        }
        if self.settled.has(round) {
            if event.what == What::Announced {
                self.settled.announced(round, 1 << place);
            }
            return;
        }
        self.first = Some(self.first.map_or(round, |first| first.min(round)));
        let meeting = self.rounds.entry(round).or_insert(Meeting {
            announced: 0,
            released: 0,
            gave_up: 0,
            begun: event.at,
            first_start: u64::MAX,
            last_start: 0,
        });
        meeting.begun = meeting.begun.min(event.at);
        let bit = 1 << place;
        match event.what {
            What::Announced => meeting.announced |= bit,
            What::GaveUp { .. } => meeting.gave_up |= bit,
            What::Released => {
                meeting.released |= bit;
                meeting.first_start = meeting.first_start.min(event.at);
                meeting.last_start = meeting.last_start.max(event.at);
            }
        }
        if self.rounds.len() > self.open {
            self.settle();
        }
    }

    /// Settles the oldest round in which no live member waits.
    fn settle(&mut self) {
        let oldest = self.rounds.iter().find(|(round, meeting)| !self.is_awaited(**round, meeting));
        let Some((&round, &meeting)) = oldest else { return };
        let mut settled = std::mem::take(&mut self.settled);
        self.count(round, &meeting, &mut settled.sum, &mut settled.skews);
        settled.add(round);
        settled.doubt(round, self.absent(round, &meeting), meeting.released);
        self.rounds.remove(&round);
        if meeting.released != 0 {
            settled.released = settled.released.max(Some(round));
            for death in self.members.iter_mut().filter_map(|member| member.died.as_mut()) {
                if meeting.begun <= death.at {
                    death.released = death.released.max(Some(round));
                }
            }
        }
        self.settled = settled;
    }

    /// Whether a live member still waits in this round. Each member waits in at most one round.
    fn is_awaited(&self, round: i64, meeting: &Meeting) -> bool {
        let ended = meeting.released | meeting.gave_up;
        self.members.iter().enumerate().any(|(place, member)| {
            let is_alive = member.died.is_none_or(|death| death.revived.is_some());
            let waits = meeting.announced & !ended & 1 << place != 0;
            waits && is_alive && member.announced <= round
        })
    }

    /// Notes that the member's node was killed.
    pub fn died(&mut self, task: TaskId, at: u64) {
        if let Some(place) = self.place(task) {
            let member = &mut self.members[place];
            let alive = member.died.is_none_or(|death| death.revived.is_some());
            if alive {
                let released = self.settled.released;
                member.died = Some(Death { at, announced: member.announced, released, revived: None });
            }
        }
    }

    /// Notes that the member's node was restarted. The member counts its rounds from the beginning, then joins the
    /// round of the other members.
    pub fn revived(&mut self, task: TaskId, at: u64) {
        if let Some(place) = self.place(task)
            && let Some(death) = &mut self.members[place].died
        {
            death.revived.get_or_insert(at);
        }
    }

    /// Notes that some of the member's announcements did not reach the launcher.
    pub fn untold(&mut self, task: TaskId) {
        if let Some(place) = self.place(task) {
            self.members[place].untold = true;
        }
    }

    /// The number of rounds that have released all members so far.
    pub fn released(&self) -> u64 {
        let all = self.all();
        self.settled.sum.released + self.rounds.values().filter(|m| m.released == all).count() as u64
    }

    /// The outcomes of all rounds.
    pub fn rounds(&self) -> Rounds {
        let (mut sum, mut skews) = (self.settled.sum, self.settled.skews.clone());
        sum.false_releases = self.settled.false_releases(self.members(|member| member.untold));
        for (&round, meeting) in &self.rounds {
            sum.false_releases += falsely(self.absent(round, meeting), meeting.released);
            self.count(round, meeting, &mut sum, &mut skews);
        }
        sum.rounds = sum.released + sum.timed_out + sum.divergent + sum.unknown;
        sum.start_skew_us = skews.spread();
        sum
    }

    /// Adds the outcome of a round to the sums, without its false releases.
    fn count(&self, round: i64, meeting: &Meeting, sum: &mut Rounds, skews: &mut Spreading) {
        match self.end(round, meeting) {
            Some(End::Released) => {
                sum.released += 1;
                skews.add(meeting.last_start - meeting.first_start);
            }
            Some(End::TimedOut) => sum.timed_out += 1,
            Some(End::Divergent) => sum.divergent += 1,
            Some(End::Unknown) => sum.unknown += 1,
            Some(End::Unfinished) => sum.unfinished += 1,
            None => {}
        }
    }

    fn place(&self, task: TaskId) -> Option<usize> {
        self.members.iter().position(|m| m.task == task)
    }

    fn all(&self) -> u64 {
        u64::MAX >> (64 - self.members.len().clamp(1, 64))
    }

    /// The set of members for which `is_so` is true.
    fn members(&self, is_so: impl Fn(&Member) -> bool) -> u64 {
        let bit = |(place, member): (usize, &Member)| u64::from(is_so(member)) << place;
        self.members.iter().enumerate().map(bit).fold(0, |set, bit| set | bit)
    }

    /// The members that may have announced this round without a report, because their nodes were killed after the round
    /// began. A node that was killed before the round began counts, too: its last message may have been the
    /// announcement, and the other members keep an announcement until its TTL ends.
    fn killed(&self, round: i64, meeting: &Meeting) -> u64 {
        self.members(|member| {
            let Some(death) = member.died else { return false };
            meeting.begun <= death.at || round <= self.last_words(&death)
        })
    }

    /// The last round that a member can have announced before it was killed. That round follows the last round that the
    /// member announced, or the last round that began before the kill and released a member.
    fn last_words(&self, death: &Death) -> i64 {
        let spoken = |(round, meeting): (&i64, &Meeting)| {
            (meeting.begun <= death.at && meeting.released != 0).then_some(*round)
        };
        let heard = self.rounds.iter().filter_map(spoken).max().max(death.released);
        let said = Some(death.announced).filter(|&round| round != i64::MIN);
        // The member reported nothing before the kill, so it can have announced no round after the first round of all.
        let before = self.first.map_or(0, |first| first - 1);
        heard.max(said).unwrap_or(before) + 1
    }

    /// The members for which the outcome of this round is unknown: they were killed before they reported it, or some of
    /// their events are missing.
    fn silenced(&self, round: i64, meeting: &Meeting) -> u64 {
        let missing = self.members(|member| member.untold);
        (missing | self.killed(round, meeting)) & !(meeting.released | meeting.gave_up)
    }

    /// The members that certainly had not arrived in this round.
    fn absent(&self, round: i64, meeting: &Meeting) -> u64 {
        let unheard = self.members(|member| member.untold) | self.killed(round, meeting);
        self.all() & !meeting.announced & !unheard
    }

    /// The outcome of a round. `None` if all members that announced it moved on to another round together.
    fn end(&self, round: i64, meeting: &Meeting) -> Option<End> {
        let (all, silenced) = (self.all(), self.silenced(round, meeting));
        let missing = all & !meeting.released;
        if missing == 0 {
            return Some(End::Released);
        }
        if meeting.released == 0 {
            return match (meeting.gave_up, silenced) {
                (0, 0) if self.moved_on(round, meeting.announced) => None,
                (0, _) => Some(End::Unfinished),
                (_, 0) => Some(End::TimedOut),
                (_, _) => Some(End::Unknown),
            };
        }
        let told = missing & !silenced;
        if told == 0 {
            Some(End::Unknown)
        } else if meeting.gave_up & told != 0 || self.moved_on(round, told) || self.buried(meeting, told) {
            Some(End::Divergent)
        } else {
            Some(End::Unfinished)
        }
    }

    /// Whether one of the members in `of` has announced a later round.
    fn moved_on(&self, round: i64, of: u64) -> bool {
        self.members.iter().enumerate().any(|(place, m)| of & 1 << place != 0 && m.announced > round)
    }

    /// Whether the node of one of the members in `of` was dead when the round began.
    fn buried(&self, meeting: &Meeting, of: u64) -> bool {
        let dead = |m: &Member| {
            m.died.is_some_and(|death| {
                death.at < meeting.begun && death.revived.is_none_or(|again| meeting.begun < again)
            })
        };
        self.members.iter().enumerate().any(|(place, m)| of & 1 << place != 0 && dead(m))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Released,
    TimedOut,
    Divergent,
    Unknown,
    Unfinished,
}

#[cfg(test)]
mod tests;
