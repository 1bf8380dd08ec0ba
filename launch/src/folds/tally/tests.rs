//! Tests of the tally: the outcomes of rounds, computed from the events of the members.

use super::*;
use crate::folds::spread::Spread;
use imrs_protocol::{PortId, Round};

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
    let events =
        [(5, 0, 1, What::Announced), (6, 1, 1, What::Announced), (205, 0, 1, GAVE_UP), (206, 1, 1, GAVE_UP)];
    assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, timed_out: 1, ..Rounds::default() });
}

#[test]
fn a_release_that_some_miss_is_divergent() {
    let mut events = all_announce(5, 1);
    events.extend([(10, 0, 1, What::Released), (11, 1, 1, What::Released), (205, 2, 1, GAVE_UP)]);
    assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, divergent: 1, ..Rounds::default() });
    // The third member moved on to a later round instead of giving up.
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
    // The release is not a false release either if the member's node was killed before it could report its announcement.
    let mut half = tally(&events);
    half.take(&Event { at: 9, task: TaskId(2), port: PortId(0), round: Round(1), what: What::Released });
    half.died(TaskId(2), 12);
    assert_eq!((half.rounds().false_releases, half.rounds().released), (0, 1));
    // The outcome of the round is unknown if the member's node was killed during the round, or before it reported anything.
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
    // The node of the third member is killed at 10. The other members give up in round 2, and meet the restarted member
    // in round 3.
    events.extend(both(20, 2, What::Announced).into_iter().chain(both(220, 2, GAVE_UP)));
    let mut tally = tally(&events);
    tally.died(TaskId(2), 10);
    tally.revived(TaskId(2), 230);
    let mut say = |at, task, round, what| {
        tally.take(&Event { at, task: TaskId(task), port: PortId(0), round: Round(round), what });
    };
    // The restarted member counts its rounds from the beginning.
    say(231, 2, 1, What::Announced);
    for task in 0..3 {
        say(240, task, 3, What::Announced);
        say(241, task, 3, What::Released);
    }
    // After the member's restart, a release of round 4 without it is a false release again.
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
    // The third member was the first to reach round 2, and was then killed. Its arrival released the other members, who
    // came later.
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
    // Member 0 moved on to round 2, in which the other members wait.
    let events = [(5, 0, 1, What::Announced), (9, 0, 2, What::Announced), (205, 0, 2, GAVE_UP)];
    assert_eq!(tally(&events).rounds(), Rounds { rounds: 1, timed_out: 1, ..Rounds::default() });
    // The run ended before the other members reported their releases.
    let mut events = all_announce(5, 1);
    events.push((9, 1, 1, What::Released));
    assert_eq!(tally(&events).rounds(), Rounds { unfinished: 1, ..Rounds::default() });
}

/// Feeds the events of rounds of three members. Most rounds release all members. In some rounds the third member is
/// absent, in others the second member gives up.
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
    // The results for a member that is killed last must be the same whether or not the tally has already dropped
    // finished rounds.
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
    assert_eq!((tally.rounds.len(), tally.settled.spans.pieces()), (OPEN, 1));
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
