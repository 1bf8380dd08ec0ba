//! Tests of the outcomes of rounds from the reports of several machines.

use super::*;
use crate::folds::tally::Tally;
use imrs_protocol::Round;

const PORT: PortId = PortId(0);
const GAVE_UP: What = What::GaveUp { waited: 200, missing: 1 };

/// The report of a task from its events, each with its round.
fn report(task: u16, events: &[(i64, What)]) -> Attended {
    let mut report = Attended { port: PORT, task: TaskId(task), ..Attended::default() };
    events.iter().for_each(|&(round, what)| report.add(round, what));
    report
}

/// The report of a task that was released in each of these rounds.
fn released_in(task: u16, rounds: std::ops::Range<i64>) -> Attended {
    let events = rounds.flat_map(|round| [(round, What::Announced), (round, What::Released)]);
    report(task, &events.collect::<Vec<_>>())
}

fn of(reports: &[Attended]) -> Rounds {
    let members = [TaskId(0), TaskId(1), TaskId(2)];
    outcomes(&members, &reports.iter().collect::<Vec<_>>())
}

fn counts(rounds: &Rounds) -> [u64; 6] {
    let Rounds { released, timed_out, divergent, unknown, unfinished, false_releases, .. } = *rounds;
    [released, timed_out, divergent, unknown, unfinished, false_releases]
}

#[test]
fn the_rounds_of_all_members_give_the_outcomes() {
    let all = [0, 1, 2].map(|task| released_in(task, 1..101));
    assert_eq!(counts(&of(&all)), [100, 0, 0, 0, 0, 0]);
    // The third member gave up the last round, in which the other members were released.
    let [a, b, _] = all;
    let mut c = released_in(2, 1..100);
    c.add(100, What::Announced);
    c.add(100, GAVE_UP);
    assert_eq!(counts(&of(&[a, b, c])), [99, 0, 1, 0, 0, 0]);
}

#[test]
fn no_member_was_released_where_all_gave_up() {
    let waits = [(1, What::Announced), (1, GAVE_UP), (2, What::Announced)];
    let all = [0, 1].map(|task| report(task, &waits));
    let late = released_in(2, 3..4);
    assert_eq!(counts(&of(&[all[0].clone(), all[1].clone(), late])), [0, 1, 0, 1, 1, 0]);
    // Without a report of the third member it is unknown whether that member was released.
    assert_eq!(counts(&of(&all)), [0, 0, 0, 1, 1, 0]);
}

#[test]
fn a_release_while_another_member_had_not_arrived_is_false_only_if_that_member_tells_of_the_round() {
    let others = [0, 1].map(|task| released_in(task, 1..4));
    let absent =
        report(2, &[(1, What::Announced), (1, What::Released), (3, What::Announced), (3, What::Released)]);
    let [a, b] = others.clone();
    assert_eq!(counts(&of(&[a, b, absent.clone()])), [2, 0, 1, 0, 0, 2]);
    // The third member's node was restarted after round 1. The report of its first start, about round 2, is missing.
    let [a, b] = others.clone();
    let second = released_in(2, 3..4);
    assert_eq!(counts(&of(&[a, b, second])), [1, 0, 0, 2, 0, 0]);
    let [a, b] = others;
    assert_eq!(counts(&of(&[a, b, Attended { is_partial: true, ..absent }])), [2, 0, 0, 1, 0, 0]);
}

#[test]
fn a_member_that_started_late_counts_its_rounds_as_the_others_do() {
    let long = [0, 1].map(|task| released_in(task, 1..200_001));
    let late = released_in(2, 3_300..3_393);
    let [a, b] = long;
    // Three wraps of 65,536 rounds had passed before the late member's node started.
    let [released, .., unknown, _, falsely] = counts(&of(&[a, b, late]));
    assert_eq!((released, unknown, falsely), (93, 200_000 - 93, 0));
}

#[test]
fn too_many_ranges_make_the_oldest_rounds_unknown() {
    let mut report = released_in(0, 1..2);
    (1..=3 * RANGES as i64).for_each(|round| report.add(2 * round, What::GaveUp { waited: 1, missing: 0 }));
    assert_eq!(report.gave_up.pieces(), RANGES);
    assert!(
        !report.announced.has(1) && report.forgotten == Some(4 * RANGES as i64),
        "{:?}",
        report.forgotten
    );
    assert_eq!(report.told().map(|(first, _)| first), Some(4 * RANGES as i64 + 2));
}

/// If every member reports every round, the sets of all members must give the same outcomes as the tally, which
/// counts the events of one machine with their times.
#[test]
fn the_sets_say_what_the_events_say() {
    let mut random = fastrand::Rng::with_seed(1987);
    for _ in 0..2_000 {
        let mut tally = Tally::new([TaskId(0), TaskId(1), TaskId(2)]);
        let mut reports = [0, 1, 2].map(|task| report(task, &[]));
        for round in 1..=9 {
            for (task, report) in reports.iter_mut().enumerate() {
                let events: &[What] = match random.u8(..8) {
                    // Every member has events in the first round and in the last round.
                    _ if round == 9 => &[What::Announced],
                    0 if round > 1 => &[],
                    1 => &[What::Announced],
                    2 | 3 => &[What::Announced, GAVE_UP],
                    4 => &[What::Released],
                    _ => &[What::Announced, What::Released],
                };
                for &what in events {
                    report.add(round, what);
                    let (task, number) = (TaskId::from_index(task), Round(round as u16));
                    tally.take(&Event { at: round as u64, task, port: PORT, round: number, what });
                }
            }
        }
        let by_events = tally.rounds();
        assert_eq!(of(&reports), Rounds { start_skew_us: None, ..by_events }, "{reports:?}");
    }
}
