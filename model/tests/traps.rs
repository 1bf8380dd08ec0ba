//! Regression tests for the parts that stateright 0.31 leaves to its user.

use crate::support::walk::{Dice, Walk, successors, walk};
use crate::support::worlds::{commands, endless, literal, scenario, timed, with};
use imrs_model::worlds::{Exchange, Meeting};
use imrs_model::{Budget, Exploration, Limits, Reductions, Scenario, Violation, Watch, WorldModel, explore};
use imrs_protocol::rules::{Confirmation, Memory, Rules};
use stateright::{Checker, Model};
use std::sync::{Arc, LazyLock};

/// Scenarios with a violation, for many kinds of property.
fn failing() -> Vec<Arc<Scenario>> {
    let unnumbered = Rules { rounds: false, ..Rules::DEFAULT };
    let silent = Rules { last_released: false, ..Rules::DEFAULT };
    let forgetful = Rules { memory: Memory::None, ..Rules::DEFAULT };
    let uncharged = Rules { charge_residence: false, ..Rules::DEFAULT };
    let meetings = [
        Meeting { rules: unnumbered, ..endless(2, 0) },
        Meeting { rules: silent, ..endless(2, 0) },
        Meeting { rules: silent, ..endless(3, 0) },
        Meeting { attempts: Some(2), ..timed(2, Watch::AllOrNone, 1, 2, 4) },
        timed(3, Watch::AllOrNone, 0, 0, 2),
        literal(2, Confirmation::EveryComplete, 2),
        literal(3, Confirmation::PassOn, 3),
        timed(3, Watch::Reachable, 0, 1, 3),
    ];
    let exchanges = [
        Exchange { rules: forgetful, ..commands(Watch::AtMostOnce) },
        Exchange { rules: uncharged, ..commands(Watch::Stale) },
    ];
    let exchanges = exchanges.iter().map(|e| e.scenario().expect("a sound declaration"));
    meetings.iter().map(scenario).chain(exchanges).collect()
}

/// Scenarios without a violation.
fn holding() -> Vec<Arc<Scenario>> {
    let crash = Meeting {
        budget: Budget { loss: 0, dup: 0, crash: 1 },
        resend: None,
        ..timed(2, Watch::FalseRelease, 0, 1, 3)
    };
    let meetings =
        [endless(2, 1), timed(2, Watch::FalseRelease, 1, 3, 5), timed(3, Watch::AllOrNone, 0, 1, 3), crash];
    let exchanges = [commands(Watch::Resolves), commands(Watch::AtMostOnce)];
    let exchanges = exchanges.iter().map(|e| e.scenario().expect("a sound declaration"));
    meetings.iter().map(scenario).chain(exchanges).collect()
}

/// A scenario without a violation, with the result of its exploration and all its states.
struct Held {
    scenario: Arc<Scenario>,
    found: Exploration,
    walk: Walk,
}

/// The scenarios without a violation, searched once for all tests.
static HELD: LazyLock<Vec<Held>> = LazyLock::new(|| {
    let held = |scenario| {
        // Two tests wait for this search, so it may use two threads.
        let (walk, found) = std::thread::scope(|scope| {
            let found = scope.spawn(|| explore(&scenario, Limits::default(), None));
            // `successors` also asserts that every listed action leads to some state.
            (walk(&scenario), found.join().expect("an exploration"))
        });
        Held { scenario, found, walk }
    };
    holding().into_iter().map(held).collect()
});

#[test]
fn a_counterexample_is_a_shortest_one() {
    for scenario in failing() {
        let found = explore(&scenario, Limits::default(), None);
        // The independent search goes level by level and compares whole states. No level before the first violation may
        // have another one.
        let shortest = walk(&scenario).violated_at;
        assert!(shortest.is_some_and(|depth| depth > 1), "{:?}", scenario.watch);
        assert_eq!(found.path.map(|path| path.len()), shortest, "{:?}", scenario.watch);
    }
}

#[test]
fn a_path_is_a_run_of_the_model() {
    for scenario in failing() {
        let found = explore(&scenario, Limits::default(), None);
        let model = WorldModel::new(&scenario, Limits::default());
        let (path, states) = (found.path.expect("fails"), found.states_on_path.expect("fails"));
        assert_eq!(states.len(), path.len() + 1);
        assert_eq!(states[..1], model.init_states());
        for (i, action) in path.iter().enumerate() {
            assert!(states[i].violation().is_none(), "a violation before the end");
            let mut enabled = Vec::new();
            model.actions(&states[i], &mut enabled);
            assert!(enabled.contains(action), "{action:?} is not among {enabled:?}");
            assert_eq!(model.next_state(&states[i], *action).as_ref(), Some(&states[i + 1]));
        }
        assert_eq!(states.last().and_then(imrs_model::Packed::violation), found.violation);
    }
}

#[test]
fn fingerprints_count_the_states_that_whole_states_count() {
    for Held { found, walk, .. } in HELD.iter() {
        assert_eq!(walk.violated_at, None);
        assert_eq!((found.states, found.transitions), (walk.states.len() as u64, walk.generated));
        assert!(found.complete);
    }
}

#[test]
fn a_canonical_state_stands_for_itself() {
    for Held { scenario, walk, .. } in HELD.iter() {
        let model = WorldModel::new(scenario, Limits::default());
        for state in walk.states.iter().filter(|state| !state.is_final()) {
            assert_eq!(model.canonical(state), *state, "{:?}", scenario.watch);
        }
    }
}

#[test]
fn a_step_depends_on_its_state_and_on_nothing_looked_at_before() {
    for Held { scenario, walk, .. } in HELD.iter() {
        let worn = WorldModel::new(scenario, Limits::default());
        // The states are taken backwards, so that the working memory of the world holds other leftovers than in the search.
        for state in walk.states.iter().rev().step_by(7).take(4_000) {
            let fresh = WorldModel::new(scenario, Limits::default());
            assert_eq!(successors(&worn, state), successors(&fresh, state), "after {state:?}");
        }
    }
}

#[test]
fn depth_first_search_reaches_the_same_states() {
    for Held { scenario, found, .. } in HELD.iter() {
        let model = WorldModel::new(scenario, Limits::default());
        let depth_first = model.checker().threads(1).spawn_dfs().join();
        assert_eq!(depth_first.unique_state_count() as u64, found.states, "{:?}", scenario.watch);
    }
}

#[test]
fn every_renaming_of_a_state_has_one_canonical_form() {
    let crash = Budget { loss: 1, dup: 0, crash: 1 };
    let worlds = [
        timed(2, Watch::FalseRelease, 1, 3, 5),
        Meeting { attempts: Some(3), ..endless(2, 1) },
        timed(3, Watch::AllOrNone, 0, 1, 3),
        Meeting { attempts: Some(2), ..endless(3, 0) },
        timed(4, Watch::Reachable, 1, 3, 5),
        Meeting { budget: crash, ..timed(2, Watch::FalseRelease, 1, 3, 5) },
        Meeting { budget: crash, ..timed(3, Watch::Waits, 0, 1, 3) },
    ];
    let mut dice = Dice(0x1987_0701);
    for meeting in worlds {
        // Turns depend on the order of members, so renamed members take turns in another order. Another test compares
        // turns.
        let free = Reductions { turns: false, ..Reductions::ALL };
        let named = with(Reductions { symmetry: false, ..free }, &meeting);
        let named = WorldModel::new(&named, Limits::default());
        let sorted = WorldModel::new(&with(free, &meeting), Limits::default());
        let mut state = named.init_states().remove(0);
        let mut renamings = 0;
        for _ in 0..1500 {
            let mut order: Vec<usize> = (0..meeting.members).collect();
            dice.shuffle(&mut order);
            let other = named.renamed(&state, &order);
            renamings += usize::from(other != state);
            assert_eq!(sorted.canonical(&state), sorted.canonical(&other), "{state:?} renamed by {order:?}");
            // Renamed members take renamed actions, so the successors must have the same canonical forms, too.
            let futures = |state| {
                let mut futures: Vec<_> = successors(&named, state)
                    .iter()
                    .map(|(_, after)| if after.is_final() { after.clone() } else { sorted.canonical(after) })
                    .map(|after| format!("{after:?}"))
                    .collect();
                futures.sort_unstable();
                futures.dedup();
                futures
            };
            assert_eq!(futures(&state), futures(&other), "after {state:?} renamed by {order:?}");
            let open: Vec<_> =
                successors(&named, &state).into_iter().filter(|(_, after)| !after.is_final()).collect();
            // The random walk restarts from time to time, because in a world in which all tasks have finished only ticks
            // pass.
            state = match open.len() {
                n if n > 0 && dice.below(25) > 0 => open[dice.below(n)].1.clone(),
                _ => named.init_states().remove(0),
            };
        }
        assert!(renamings > 150, "only {renamings} states changed by their renaming");
    }
}

#[test]
fn a_budget_of_states_ends_a_search_without_a_verdict() {
    let scenario = scenario(&timed(2, Watch::FalseRelease, 1, 3, 5));
    let whole = explore(&scenario, Limits::default(), None);
    assert!(whole.complete && whole.states > 500, "{whole:?}");
    let cut = explore(&scenario, Limits { states: 100, ..Limits::default() }, None);
    assert!(!cut.complete && cut.violation.is_none() && cut.path.is_none());
    assert!((100..whole.states / 2).contains(&cut.states), "{} states", cut.states);
}

#[test]
fn a_budget_of_memory_ends_a_search_without_a_verdict() {
    let scenario = scenario(&timed(3, Watch::AllOrNone, 0, 1, 3));
    let cut = explore(&scenario, Limits { memory: 1, ..Limits::default() }, None);
    assert!(!cut.complete && cut.violation.is_none());
    assert!(cut.states < 60_000, "{} states", cut.states);
}

#[test]
fn a_violation_within_the_budget_is_a_verdict() {
    let scenario = scenario(&literal(2, Confirmation::EveryComplete, 2));
    let needed = walk(&scenario).states.len() as u64;
    let found = explore(&scenario, Limits { states: needed, ..Limits::default() }, None);
    assert!(found.complete && found.violation == Some(Violation::Stranded));
}

#[test]
fn no_state_is_a_dead_end_unless_everybody_has_finished() {
    let untimed =
        [2, 3].map(|n| scenario(&Meeting { attempts: Some(2), ..Meeting::new(n, Watch::FalseRelease) }));
    let mut ends = 0;
    for scenario in holding().into_iter().chain(untimed) {
        // With the reduction by turns, some interleavings lead nowhere: there a closed node waits for a packet that never
        // comes.
        let mut free = Scenario::clone(&scenario);
        free.reductions.turns = false;
        let scenario = Arc::new(free);
        let model = WorldModel::new(&scenario, Limits::default());
        for state in walk(&scenario).states.iter().filter(|state| !state.is_final()) {
            if successors(&model, state).is_empty() {
                assert!(model.is_finished(state), "{state:?} has no way on");
                ends += 1;
            }
        }
    }
    assert!(ends > 0, "the worlds without time end");
}

#[test]
fn a_way_too_long_for_its_field_is_a_visible_failure() {
    let meeting = Meeting { delay: Some(20), ..timed(2, Watch::FalseRelease, 0, 21, 60) };
    assert_eq!(explore(&scenario(&meeting), Limits::default(), None).violation, Some(Violation::Overflow));
}
