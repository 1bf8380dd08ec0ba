//! Compares the packed form of states with the reference form: without reductions, both have the same states and
//! transitions.

use crate::support::reference::ReferenceModel;
use crate::support::worlds::{commands, endless, timed, with};
use imrs_model::worlds::Meeting;
use imrs_model::{Budget, Exploration, Limits, Reductions, Scenario, Watch, explore};
use imrs_protocol::rules::Rules;
use stateright::{Checker, Model};
use std::sync::Arc;

/// Explores both forms and compares the counts of unique and generated states, the depth and the verdict.
fn agree(scenario: &Arc<Scenario>) -> Exploration {
    let packed = explore(scenario, Limits::default(), None);
    println!("{} states, {} transitions", packed.states, packed.transitions);
    let reference = ReferenceModel::new(scenario, u64::MAX).checker().threads(1).spawn_bfs().join();
    let path = reference.discoveries().remove("claim");
    let found = path.as_ref().and_then(|path| path.last_state().violation);
    assert_eq!(found, packed.violation);
    assert_eq!(path.map(|p| p.into_actions().len()), packed.path.as_ref().map(Vec::len));
    let counts = (reference.unique_state_count(), reference.state_count(), reference.max_depth());
    assert_eq!(counts, (packed.states as usize, packed.transitions as usize, packed.depth as usize));
    packed
}

#[test]
fn two_members_meet_with_a_loss_and_a_duplicate() {
    let budget = Budget { loss: 1, dup: 1, crash: 0 };
    let meeting = Meeting { budget, ..timed(2, Watch::FalseRelease, 1, 3, 5) };
    let found = agree(&with(Reductions::NONE, &meeting));
    assert!(found.states > 1_000 && found.violation.is_none());
}

#[test]
fn two_members_meet_again_and_again() {
    let meeting = Meeting { attempts: Some(3), ..endless(2, 1) };
    let found = agree(&with(Reductions::NONE, &meeting));
    assert!(found.states > 100 && found.violation.is_none());
}

#[test]
fn three_members_meet_once() {
    let meeting = Meeting { delay: Some(1), ..Meeting::new(3, Watch::FalseRelease) };
    let found = agree(&with(Reductions::NONE, &meeting));
    assert!(found.states > 1_000 && found.violation.is_none());
}

#[test]
fn a_margin_too_small_diverges_at_the_same_depth() {
    let meeting = Meeting { attempts: Some(2), ..timed(2, Watch::AllOrNone, 1, 2, 4) };
    assert!(agree(&with(Reductions::NONE, &meeting)).violation.is_some());
}

#[test]
fn silence_about_the_last_release_unpairs_at_the_same_depth() {
    let rules = Rules { last_released: false, ..Rules::DEFAULT };
    let meeting = Meeting { rules, ..endless(2, 0) };
    assert!(agree(&with(Reductions::NONE, &meeting)).violation.is_some());
}

#[test]
fn commands_are_sent_again_lost_and_duplicated() {
    let mut scenario = Arc::unwrap_or_clone(commands(Watch::AtMostOnce).scenario().unwrap());
    scenario.reductions = Reductions::NONE;
    let found = agree(&Arc::new(scenario));
    assert!(found.states > 1_000 && found.violation.is_none());
}
