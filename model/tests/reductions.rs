//! Each reduction can be switched off, and then reaches the same verdict and the same shortest length.

mod support;

use imrs_model::worlds::Meeting;
use imrs_model::{Exploration, Limits, Reductions, Watch, explore};
use imrs_protocol::rules::{Confirmation, Rules};
use support::worlds::{endless, literal, timed, with};

const ONE_OFF: [Reductions; 4] = [
    Reductions { symmetry: false, ..Reductions::ALL },
    Reductions { ignores: false, ..Reductions::ALL },
    Reductions { lose_last: false, ..Reductions::ALL },
    Reductions::NONE,
];

fn run(reductions: Reductions, meeting: &Meeting) -> Exploration {
    let found = explore(&with(reductions, meeting), Limits::default(), None);
    assert!(found.complete);
    found
}

/// Compares all reductions with each one off and with all off. Returns how many times fewer states there are.
fn same(meeting: &Meeting) -> f64 {
    let reduced = run(Reductions::ALL, meeting);
    let mut ratio = 0.0;
    for reductions in ONE_OFF {
        let found = run(reductions, meeting);
        assert_eq!(found.violation, reduced.violation, "{reductions:?}");
        let length = |found: &Exploration| found.path.as_ref().map(Vec::len);
        assert_eq!(length(&found), length(&reduced), "{reductions:?}");
        // A failing search stops somewhere within a level: its counts say nothing.
        assert!(found.violation.is_some() || found.states >= reduced.states, "{reductions:?}");
        ratio = found.states as f64 / reduced.states as f64;
    }
    println!("{:?} of {}: {ratio:.1} times fewer states", meeting.watch, meeting.members);
    ratio
}

#[test]
fn two_members_hold() {
    same(&timed(2, Watch::FalseRelease, 1, 3, 5));
    same(&timed(2, Watch::AllOrNone, 1, 3, 5));
    same(&Meeting { attempts: Some(2), ..endless(2, 1) });
}

#[test]
fn two_members_fail() {
    let unnumbered = Rules { rounds: false, ..Rules::DEFAULT };
    let silent = Rules { last_released: false, ..Rules::DEFAULT };
    same(&Meeting { rules: unnumbered, ..endless(2, 0) });
    same(&Meeting { rules: silent, ..endless(2, 0) });
    same(&timed(2, Watch::AllOrNone, 0, 0, 2));
    same(&Meeting { attempts: Some(2), ..timed(2, Watch::AllOrNone, 1, 2, 4) });
    same(&timed(2, Watch::Reachable, 1, 3, 5));
}

/// A loss just before the faults stop must not be lost to a reduction. Only verdicts are compared: where a packet that
/// nobody notices does not vanish, it must still arrive before time can pass, and the way is longer. (With packets that
/// nobody notices kept, the endless attempts of these worlds take minutes.)
#[test]
fn two_members_meet_again() {
    for (attempts, holds) in [(1, false), (2, true)] {
        let meeting = Meeting { attempts: Some(2), ..timed(2, Watch::MeetAgain { attempts }, 1, 3, 5) };
        for reductions in [Reductions::ALL, ONE_OFF[0], ONE_OFF[2]] {
            let found = run(reductions, &meeting);
            assert_eq!(found.violation.is_none(), holds, "{attempts} attempts, {reductions:?}");
        }
    }
}

#[test]
fn three_members_fail() {
    let silent = Rules { last_released: false, ..Rules::DEFAULT };
    same(&Meeting { rules: silent, attempts: Some(2), ..endless(3, 0) });
    same(&timed(3, Watch::AllOrNone, 0, 0, 2));
    same(&timed(3, Watch::Reachable, 0, 1, 3));
}

#[test]
fn stranding_needs_as_many_losses() {
    for confirmation in [Confirmation::None, Confirmation::EveryComplete] {
        for loss in 0..=2 {
            let meeting = literal(2, confirmation, loss);
            let verdict = run(Reductions::ALL, &meeting).violation;
            for reductions in ONE_OFF {
                assert_eq!(run(reductions, &meeting).violation, verdict, "{reductions:?} {loss}");
            }
        }
    }
}

#[test]
fn three_members_hold_in_far_fewer_states() {
    let ratio = same(&timed(3, Watch::FalseRelease, 0, 0, 2));
    assert!(ratio >= 5.0, "only {ratio:.1}");
}
