//! Counts the outcomes of the rounds of a waitfor, from the events that its members reported.

use super::lines::{Event, What};
use super::rounds::Rounds;
use super::settled::{Settled, falsely};
use super::spread::Spreading;
use imrs_protocol::{Round, TaskId};
use std::collections::BTreeMap;

/// Most rounds that are kept one by one. Older rounds are settled without waiting for further events.
const OPEN: usize = 4_096;
/// The rounds of one waitfor. The newest are kept one by one; older ones are settled: added to the sums and dropped.
#[derive(Clone, Debug)]
pub struct Tally {
    members: Vec<Member>,
    /// The rounds that are not settled yet, by number.
    rounds: BTreeMap<i64, Meeting>,
    /// Most rounds that are kept unsettled.
    open: usize,
    /// The lowest round that any event named.
    first: Option<i64>,
    settled: Settled,
}

#[derive(Clone, Debug)]
struct Member {
    task: TaskId,
    /// The round of its last event, extended across the wrap of [`Round`].
    last: i64,
    /// The last round that it announced.
    announced: i64,
    /// The last kill of its node. Events from just before it were not reported.
    died: Option<Death>,
    /// Whether some of its announcements were not reported.
    untold: bool,
}

#[derive(Clone, Copy, Debug)]
struct Death {
    at: u64,
    /// The last round that the member had announced by then.
    announced: i64,
    /// The last settled round that began before the kill and released a member.
    released: Option<i64>,
    /// When its node was restarted.
    revived: Option<u64>,
}

/// What is known of one round. Sets of members are bit masks by position.
#[derive(Clone, Copy, Debug)]
struct Meeting {
    announced: u64,
    released: u64,
    gave_up: u64,
    /// The time of its earliest event.
    begun: u64,
    first_start: u64,
    last_start: u64,
}

impl Tally {
    /// A waitfor of these tasks (at most 64), without any events.
    pub fn new(members: impl IntoIterator<Item = TaskId>) -> Self {
        let member = |task| Member { task, last: 0, announced: i64::MIN, died: None, untold: false };
        let members = members.into_iter().map(member).collect();
        Self { members, rounds: BTreeMap::new(), open: OPEN, first: None, settled: Settled::default() }
    }

    /// Takes an event of a member. Events of each member come in order.
    pub fn take(&mut self, event: &Event) {
        let Some(place) = self.place(event.task) else { return };
        let member = &mut self.members[place];
        let round = member.count_on(event.round);
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

    /// Whether a live member still waits in this round. Each member waits in at most one.
    fn is_awaited(&self, round: i64, meeting: &Meeting) -> bool {
        let ended = meeting.released | meeting.gave_up;
        self.members.iter().enumerate().any(|(place, member)| {
            let is_alive = member.died.is_none_or(|death| death.revived.is_some());
            let waits = meeting.announced & !ended & 1 << place != 0;
            waits && is_alive && member.announced <= round
        })
    }

    /// The member's node was killed.
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

    /// The member's node was restarted. The member counts its rounds from the beginning, then joins those of the others.
    pub fn revived(&mut self, task: TaskId, at: u64) {
        if let Some(place) = self.place(task)
            && let Some(death) = &mut self.members[place].died
        {
            death.revived.get_or_insert(at);
        }
    }

    /// Some of the member's announcements were not reported.
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

    /// The set of members that satisfy a predicate.
    fn members(&self, is_so: impl Fn(&Member) -> bool) -> u64 {
        let bit = |(place, member): (usize, &Member)| u64::from(is_so(member)) << place;
        self.members.iter().enumerate().map(bit).fold(0, |set, bit| set | bit)
    }

    /// The members that may have announced this round unreported: their nodes were killed after it began. Or they were killed
    /// before, but its announcement may have been their last message, which the others keep for the rest of its TTL.
    fn killed(&self, round: i64, meeting: &Meeting) -> u64 {
        self.members(|member| {
            let Some(death) = member.died else { return false };
            meeting.begun <= death.at || round <= self.last_words(&death)
        })
    }

    /// The last round that a member can have announced before it was killed. It is the successor of the last round that it
    /// announced, or that began before the kill and released a member.
    fn last_words(&self, death: &Death) -> i64 {
        let spoken = |(round, meeting): (&i64, &Meeting)| {
            (meeting.begun <= death.at && meeting.released != 0).then_some(*round)
        };
        let heard = self.rounds.iter().filter_map(spoken).max().max(death.released);
        let said = Some(death.announced).filter(|&round| round != i64::MIN);
        // Nothing was reported before the kill: it is the first round of all.
        let before = self.first.map_or(0, |first| first - 1);
        heard.max(said).unwrap_or(before) + 1
    }

    /// The members for which the end of this round is unknown: they were killed before they reported it, or some of their
    /// events are missing.
    fn silenced(&self, round: i64, meeting: &Meeting) -> u64 {
        let missing = self.members(|member| member.untold);
        (missing | self.killed(round, meeting)) & !(meeting.released | meeting.gave_up)
    }

    /// The members that are known not to have arrived.
    fn absent(&self, round: i64, meeting: &Meeting) -> u64 {
        let unheard = self.members(|member| member.untold) | self.killed(round, meeting);
        self.all() & !meeting.announced & !unheard
    }

    /// The outcome of a round. `None` if the members that announced it moved on to another round together.
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

    /// Whether one of these members has announced a later round.
    fn moved_on(&self, round: i64, of: u64) -> bool {
        self.members.iter().enumerate().any(|(place, m)| of & 1 << place != 0 && m.announced > round)
    }

    /// Whether a node of one of these members was down when the round began.
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

impl Member {
    /// Extends a round number across the wrap: it takes the value nearest to the last one.
    fn count_on(&mut self, round: Round) -> i64 {
        let last = Round(self.last.rem_euclid(1 << 16) as u16);
        let (ahead, behind) = (round.steps_from(last), last.steps_from(round));
        self.last += if ahead <= behind { i64::from(ahead) } else { -i64::from(behind) };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::launch::spread::Spread;
    use imrs_protocol::PortId;

    const GAVE_UP: What = What::GaveUp { waited: 200, missing: 4 };

    fn tally(events: &[(u64, u16, u16, What)]) -> Tally {
        let mut tally = Tally::new([TaskId(0), TaskId(1), TaskId(2)]);
        for &(at, task, round, what) in events {
            let (task, round) = (TaskId(task), Round(round));
            tally.take(&Event { at, task, port: PortId(0), round, what });
        }
        tally
    }

    fn all_announce(at: u64, round: u16) -> Vec<(u64, u16, u16, What)> {
        (0..3).map(|task| (at, task, round, What::Announced)).collect()
    }

    #[test]
    fn a_round_that_releases_all_counts_its_skew() {
        let mut events = all_announce(5, 1);
        events.extend([(10, 0, 1, What::Released), (14, 2, 1, What::Released), (11, 1, 1, What::Released)]);
        let rounds = tally(&events).rounds();
        let skew = Some(Spread { p50: 4, p99: 4, max: 4 });
        assert_eq!(rounds, Rounds { rounds: 1, released: 1, start_skew_us: skew, ..Rounds::default() });
    }

    #[test]
    fn a_round_that_releases_nobody_has_timed_out() {
        let events = [
            (5, 0, 1, What::Announced),
            (6, 1, 1, What::Announced),
            (205, 0, 1, GAVE_UP),
            (206, 1, 1, GAVE_UP),
        ];
        assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, timed_out: 1, ..Rounds::default() });
    }

    #[test]
    fn a_release_that_some_miss_is_divergent() {
        let mut events = all_announce(5, 1);
        events.extend([(10, 0, 1, What::Released), (11, 1, 1, What::Released), (205, 2, 1, GAVE_UP)]);
        assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, divergent: 1, ..Rounds::default() });
        // The third member moved on to a fresher round instead.
        events.pop();
        events.push((50, 2, 2, What::Announced));
        let rounds = tally(&events).rounds();
        assert_eq!((rounds.divergent, rounds.unfinished), (1, 1));
    }

    #[test]
    fn a_release_without_an_announcement_is_false() {
        let events = [
            (5, 0, 1, What::Announced),
            (5, 1, 1, What::Announced),
            (9, 0, 1, What::Released),
            (9, 1, 1, What::Released),
        ];
        assert_eq!(tally(&events).rounds().false_releases, 2);
        let mut unheard = tally(&events);
        unheard.untold(TaskId(2));
        assert_eq!(unheard.rounds().false_releases, 0);
        // Nor if its release was reported, but not its announcement, before its node was killed.
        let mut half = tally(&events);
        half.take(&Event { at: 9, task: TaskId(2), port: PortId(0), round: Round(1), what: What::Released });
        half.died(TaskId(2), 12);
        assert_eq!((half.rounds().false_releases, half.rounds().released), (0, 1));
        // The outcome is unknown if the node was killed during the round, or before it reported anything.
        for at in [7, 4] {
            let mut killed = tally(&events);
            killed.died(TaskId(2), at);
            assert_eq!(killed.rounds(), Rounds { rounds: 1, unknown: 1, ..Rounds::default() });
        }
        // A member that was killed before a round began cannot have announced the next one.
        let mut later = events.to_vec();
        later.extend(events.map(|(at, task, _, what)| (at + 10, task, 2, what)));
        let mut killed = tally(&later);
        killed.died(TaskId(2), 4);
        let rounds = killed.rounds();
        assert_eq!((rounds.unknown, rounds.divergent, rounds.false_releases), (1, 1, 2));
    }

    #[test]
    fn who_was_started_again_counts_again() {
        let both = |at, round, what| [(at, 0, round, what), (at, 1, round, what)];
        let mut events = all_announce(5, 1);
        events.extend((0..3).map(|task| (6, task, 1, What::Released)));
        // The node is killed at 10. The others give up in round 2, and meet the member again in round 3.
        events.extend(both(20, 2, What::Announced).into_iter().chain(both(220, 2, GAVE_UP)));
        let mut tally = tally(&events);
        tally.died(TaskId(2), 10);
        tally.revived(TaskId(2), 230);
        let mut say = |at, task, round, what| {
            tally.take(&Event { at, task: TaskId(task), port: PortId(0), round: Round(round), what });
        };
        // The restarted member counts from the beginning.
        say(231, 2, 1, What::Announced);
        for task in 0..3 {
            say(240, task, 3, What::Announced);
            say(241, task, 3, What::Released);
        }
        // After its restart, a release of round 4 without it is false again.
        for task in 0..2 {
            say(250, task, 4, What::Announced);
            say(251, task, 4, What::Released);
        }
        let rounds = tally.rounds();
        assert_eq!((rounds.released, rounds.unknown, rounds.false_releases), (2, 1, 2));
    }

    #[test]
    fn what_a_killed_node_did_last_is_unknown_and_later_it_did_nothing() {
        let events = [
            (5, 0, 1, What::Announced),
            (5, 1, 1, What::Announced),
            (205, 0, 1, GAVE_UP),
            (205, 1, 1, GAVE_UP),
            (300, 0, 2, What::Announced),
            (500, 0, 2, GAVE_UP),
        ];
        let mut tally = tally(&events);
        tally.died(TaskId(2), 100);
        assert_eq!(tally.rounds(), Rounds { rounds: 2, timed_out: 1, unknown: 1, ..Rounds::default() });
    }

    #[test]
    fn the_last_announcement_of_a_killed_node_may_be_untold() {
        // It was the first to reach round 2 and was killed. Its arrival released the others, who came later.
        let both = |at, round, what| [(at, 0, round, what), (at, 1, round, what)];
        let mut events = vec![(5, 2, 1, What::Announced), (6, 2, 1, What::Released)];
        events.extend(both(5, 1, What::Announced).into_iter().chain(both(6, 1, What::Released)));
        events.extend(both(12, 2, What::Announced).into_iter().chain(both(13, 2, What::Released)));
        let mut tally = tally(&events);
        tally.died(TaskId(2), 9);
        let rounds = tally.rounds();
        assert_eq!((rounds.false_releases, rounds.released, rounds.divergent, rounds.unknown), (0, 1, 0, 1));
    }

    #[test]
    fn rounds_that_nobody_waited_out_are_no_rounds() {
        // Member 0 moved on to a round that others wait in.
        let events = [(5, 0, 1, What::Announced), (9, 0, 2, What::Announced), (205, 0, 2, GAVE_UP)];
        assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, timed_out: 1, ..Rounds::default() });
        // The run ended before the others reported their releases.
        let mut events = all_announce(5, 1);
        events.push((9, 1, 1, What::Released));
        assert_eq!(tally(&events).rounds(), Rounds { unfinished: 1, ..Rounds::default() });
    }

    /// Feeds rounds of three members. Most release all; in some the third member is absent, in some the second one gives up.
    fn feed(tally: &mut Tally, from: u64, to: u64) {
        for step in from..to {
            let at = step * 1_000;
            let round = Round((step % (1 << 16)) as u16);
            let mut say = |task, after, what| {
                tally.take(&Event { at: at + after, task: TaskId(task), port: PortId(0), round, what });
            };
            let there = if step % 7 == 3 { 2 } else { 3 };
            (0..there).for_each(|task| say(task, u64::from(task), What::Announced));
            for task in 0..there {
                let misses = there == 2 || step % 11 == 5 && task == 1;
                say(task, 200 + step % 100 * u64::from(task), if misses { GAVE_UP } else { What::Released });
            }
        }
    }

    #[test]
    fn what_is_settled_counts_as_it_did_before() {
        let [mut plain, mut folded] = [usize::MAX, 16].map(|open| Tally { open, ..tally(&[]) });
        for tally in [&mut plain, &mut folded] {
            feed(tally, 1, 500);
        }
        assert_eq!(folded.rounds(), plain.rounds());
        assert_eq!((folded.released(), folded.rounds.len()), (plain.released(), 16));
        let rounds = plain.rounds();
        assert!(rounds.released > 300 && rounds.timed_out > 50 && rounds.divergent > 30, "{rounds:?}");
        // `last_words` is the same whether or not the rounds are settled.
        for tally in [&mut plain, &mut folded] {
            tally.died(TaskId(2), 500_500);
        }
        assert_eq!(
            folded.last_words(&folded.members[2].died.unwrap()),
            plain.last_words(&plain.members[2].died.unwrap())
        );
        // A late event of a settled round changes nothing.
        let late = Event { at: 900_000, task: TaskId(0), port: PortId(0), round: Round(7), what: GAVE_UP };
        let before = folded.rounds();
        folded.take(&late);
        assert_eq!(folded.rounds(), before);
    }

    #[test]
    fn a_settled_round_without_an_announcement_is_false_until_it_is_known_that_some_are_missing() {
        let mut tally = Tally { open: 4, ..tally(&[]) };
        for round in 1..=10 {
            for (task, what) in [(0, What::Announced), (1, What::Announced), (0, What::Released)] {
                tally.take(&Event { at: 5, task: TaskId(task), port: PortId(0), round: Round(round), what });
            }
        }
        assert_eq!((tally.rounds().false_releases, tally.rounds.len()), (10, 4));
        let late = Event { at: 5, task: TaskId(2), port: PortId(0), round: Round(1), what: What::Announced };
        tally.take(&late);
        assert_eq!(tally.rounds().false_releases, 9);
        tally.untold(TaskId(2));
        assert_eq!(tally.rounds().false_releases, 0);
    }

    #[test]
    fn a_million_rounds_take_no_more_room_than_some_thousand() {
        let mut tally = tally(&[]);
        feed(&mut tally, 1, 1_000_001);
        let rounds = tally.rounds();
        assert_eq!(rounds.rounds + rounds.unfinished, 1_000_000);
        assert_eq!(rounds.timed_out, (1..=1_000_000).filter(|step| step % 7 == 3).count() as u64);
        assert_eq!((tally.rounds.len(), tally.settled.spans.len()), (OPEN, 1));
        assert!(tally.settled.skews.size() < 8_000);
        assert_eq!(rounds.start_skew_us.map(|skew| skew.max), Some(198));
    }

    #[test]
    fn rounds_are_counted_on_across_the_wrap() {
        let mut tally = Tally::new([TaskId(0), TaskId(1)]);
        for step in 1..=70_000_u32 {
            let round = Round((step % (1 << 16)) as u16);
            for what in [What::Announced, What::Released] {
                for task in [TaskId(0), TaskId(1)] {
                    tally.take(&Event { at: u64::from(step), task, port: PortId(0), round, what });
                }
            }
        }
        assert_eq!((tally.rounds().released, tally.rounds().rounds), (70_000, 70_000));
    }
}
