//! Tests of a couple's lease under the checker: how close the least lease that a declaration may have is to a lease that
//! fails (D78).

use imrs_model::cell_state::explore_cell_state;
use imrs_model::cell_state::plan::{CellProperty, Faults, Goal};
use imrs_model::cell_state::worlds::Couple;
use imrs_model::{Limits, Violation};
use imrs_protocol::margin::least_lease;
use imrs_protocol::rules::LeaseRule;
use imrs_protocol::{CellError, Ticks};

fn couple(delay: u64, every: u64, drift: u8) -> Couple {
    let lease = least_lease(Ticks(delay), Ticks(every), Ticks(1)).0;
    let faults = Faults { drift, ..Faults::default() };
    let watch = CellProperty::Reach(Goal::Fenced);
    Couple {
        delay,
        lease,
        takeover: 3 * lease,
        every,
        mutual: false,
        rule: LeaseRule::Echoed,
        epoch: 0,
        faults,
        watch,
    }
}

fn is_ever_fenced(couple: &Couple) -> bool {
    let plan = couple.plan().expect("a checked cell");
    let found = explore_cell_state(&plan, Limits::default());
    assert!(
        found.complete && found.violation.is_none_or(|v| v == Violation::Reached),
        "{:?}",
        found.violation
    );
    found.violation.is_some()
}

/// If link delays keep their bounds, the least lease is renewed in time, but one tick of clock drift is too much for
/// it. A lease that is a tick shorter is an error of the declaration.
#[test]
fn the_least_lease_lasts_and_has_no_tick_to_spare() {
    for (delay, every) in [(1, 2), (1, 3), (2, 3)] {
        let least = couple(delay, every, 0);
        assert!(!is_ever_fenced(&least), "delay {delay}, every {every}");
        assert!(is_ever_fenced(&couple(delay, every, 1)), "delay {delay}, every {every}, with drift");
        let shorter = Couple { lease: least.lease - 1, ..least.clone() };
        let errors = shorter.plan().map(|_| ()).expect_err("too short");
        assert!(
            matches!(errors[..], [CellError::LeaseTooShort { least: l, .. }] if l.0 == least.lease),
            "{errors:?}"
        );
    }
}
