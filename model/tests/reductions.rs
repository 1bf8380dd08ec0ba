//! Tests that each reduction can be switched off without changing the verdict or the length of the shortest counterexample.

use crate::support::walk::{successors, walk};
use crate::support::worlds::{commands, endless, literal, scenario, timed, with};
use imrs_model::worlds::Meeting;
use imrs_model::{
    Action, Budget, Exploration, Limits, Packed, Reductions, Scenario, Watch, WorldModel, explore,
};
use imrs_protocol::rules::{Confirmation, Rules};
use std::collections::HashSet;
use std::sync::Arc;

const ONE_OFF: [Reductions; 5] = [
    Reductions { symmetry: false, ..Reductions::ALL },
    Reductions { ignores: false, ..Reductions::ALL },
    Reductions { lose_last: false, turns: false, ..Reductions::ALL },
    Reductions { turns: false, ..Reductions::ALL },
    Reductions::NONE,
];

fn run(reductions: Reductions, meeting: &Meeting) -> Exploration {
    let found = explore(&with(reductions, meeting), Limits::default(), None);
    assert!(found.complete);
    found
}

/// Compares the search with all reductions with searches in which one or all of them are off. Returns by which factor all
/// reductions together reduce the states.
fn same(meeting: &Meeting) -> f64 {
    let reduced = run(Reductions::ALL, meeting);
    let mut ratio = 0.0;
    for reductions in ONE_OFF {
        let found = run(reductions, meeting);
        assert_eq!(found.violation, reduced.violation, "{reductions:?}");
        let length = |found: &Exploration| found.path.as_ref().map(Vec::len);
        assert_eq!(length(&found), length(&reduced), "{reductions:?}");
        // A search that finds a violation stops within a level, so its counts say nothing. With the reduction by turns
        // there are fewer transitions, but states also differ by which node's turn it is.
        let fewer = found.states >= reduced.states || (!reductions.turns && reductions.ignores);
        assert!(found.violation.is_some() || fewer, "{reductions:?}");
        // After a crash all nodes take turns again, so some interleavings of a tick are explored twice.
        let crashes = meeting.budget.crash > 0 && !reductions.turns && reductions.ignores;
        let fewer = found.transitions >= reduced.transitions || crashes;
        assert!(found.violation.is_some() || fewer, "{reductions:?}");
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

/// Sorting members with equal features also considers their incarnations. When no node can crash any more, unnoticed
/// packets are dropped.
#[test]
fn members_that_restart() {
    let crash = Budget { loss: 0, dup: 0, crash: 1 };
    let restart = |members| Meeting { budget: crash, ..timed(members, Watch::FalseRelease, 0, 1, 3) };
    same(&restart(2));
    same(&Meeting { budget: Budget { loss: 1, dup: 1, crash: 1 }, ..restart(2) });
    same(&Meeting { watch: Watch::Waits, ..restart(2) });
    same(&Meeting { attempts: Some(2), resend: None, ..restart(2) });
    let eager = Rules { quarantine: false, ..Rules::DEFAULT };
    same(&Meeting { attempts: Some(2), resend: None, rules: eager, ..restart(2) });
    let ratio = same(&Meeting { hurry: true, resend: None, ..restart(3) });
    assert!(ratio >= 5.0, "only {ratio:.1}");
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

/// No reduction may miss a loss just before the faults end. Only verdicts are compared, because without the reduction an
/// unnoticed packet must still arrive before time can pass, which makes paths longer. (If such packets are kept, the
/// endless attempts of these scenarios take minutes.)
#[test]
fn two_members_meet_again() {
    for (attempts, holds) in [(1, false), (2, true)] {
        let meeting = Meeting { attempts: Some(2), ..timed(2, Watch::MeetAgain { attempts }, 1, 3, 5) };
        for reductions in [Reductions::ALL, ONE_OFF[0], ONE_OFF[2], ONE_OFF[3]] {
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

/// Without reductions there are 340,000 states, and the verdict needs all of them.
#[test]
fn three_members_hold_in_far_fewer_states() {
    let ratio = same(&timed(3, Watch::FalseRelease, 0, 0, 2));
    assert!(ratio >= 5.0, "only {ratio:.1}");
}

/// Without reductions there are 480,000 states, and the verdict needs all of them.
#[test]
fn all_reductions_together_leave_a_twentieth_of_the_states() {
    let meeting = Meeting { resend: None, ..timed(3, Watch::FalseRelease, 0, 1, 3) };
    let [all, none] = [Reductions::ALL, Reductions::NONE].map(|reductions| run(reductions, &meeting));
    assert!(all.violation.is_none() && none.violation.is_none());
    assert!(none.states >= 20 * all.states, "{} states and {}", all.states, none.states);
}

/// The states to which a tick, a restart or the end of faults leads, without the marks of the reduction by turns.
fn after_barriers(scenario: &Arc<Scenario>) -> HashSet<Packed> {
    let model = WorldModel::new(scenario, Limits::default());
    let mut found = HashSet::new();
    for state in walk(scenario).states.iter().filter(|state| !state.is_final()) {
        for (action, after) in successors(&model, state) {
            let barrier = matches!(action, Action::Tick | Action::Restart(_) | Action::Heal);
            if barrier && !after.is_final() {
                found.insert(model.without_turns(&after));
            }
        }
    }
    found
}

/// All interleavings between two ticks lead to the same states after the ticks.
#[test]
fn turns_lead_to_the_same_states_after_every_tick() {
    let crash = Budget { loss: 0, dup: 0, crash: 1 };
    let twice = Budget { loss: 1, dup: 1, crash: 0 };
    let meetings = [
        timed(2, Watch::FalseRelease, 1, 3, 5),
        Meeting { attempts: Some(2), ..timed(2, Watch::AllOrNone, 1, 3, 5) },
        Meeting { budget: twice, ..timed(2, Watch::FalseRelease, 1, 3, 5) },
        Meeting { budget: crash, resend: None, ..timed(2, Watch::FalseRelease, 0, 1, 3) },
        Meeting { attempts: Some(2), ..timed(2, Watch::MeetAgain { attempts: 2 }, 1, 3, 5) },
        Meeting { delay: Some(2), ..timed(2, Watch::AllOrNone, 0, 2, 5) },
        timed(3, Watch::AllOrNone, 0, 0, 2),
    ];
    // If rounds or commands follow each other, it depends on the interleaving when a packet is found to be unnoticed.
    let noticed = Reductions { ignores: false, ..Reductions::ALL };
    let exchanges = [Watch::AtMostOnce, Watch::Resolves];
    let exchanges = exchanges.map(|watch| {
        let scenario = commands(watch).scenario().expect("a sound declaration");
        Arc::new(Scenario { reductions: noticed, ..Arc::unwrap_or_clone(scenario) })
    });
    let endless =
        [Meeting { attempts: Some(1), ..endless(3, 0) }, Meeting { attempts: Some(2), ..endless(2, 1) }];
    let endless = endless.map(|meeting| with(noticed, &meeting));
    for scenario in meetings.iter().map(scenario).chain(exchanges).chain(endless) {
        let turns = |turns| {
            let mut scenario = Scenario::clone(&scenario);
            scenario.reductions.turns = turns;
            after_barriers(&Arc::new(scenario))
        };
        let (with, without) = (turns(true), turns(false));
        println!("{:?}: {} states after a tick", scenario.watch, with.len());
        assert!(with == without, "{:?}: {} and {}", scenario.watch, with.len(), without.len());
    }
}
