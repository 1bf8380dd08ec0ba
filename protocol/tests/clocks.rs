//! Tests that the value of a clock has no effect: messages carry remaining time, so the uptime of a node changes nothing
//! (D37).

use crate::support::NextExpiry;
use crate::support::plan::plans;
use crate::support::world::{Op, World, lively, ops};
use imrs_protocol::*;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn how_long_a_node_has_been_running_changes_nothing(
        plan in plans(), ops in ops(), ahead in prop::collection::vec(0..1_u64 << 50, 1..5), restarts: bool,
    ) {
        let table = plan.build();
        let rules = table.cell().rules;
        // The variant in which messages carry instants depends on clocks, to show why the decided rule does not (D37).
        prop_assume!(rules.time_stamp == Rules::DEFAULT.time_stamp);
        let mut plain = World::new(&table, restarts);
        let mut other = plain.clone();
        let tasks = other.tasks.iter_mut().zip(&other.tables).zip(ahead.iter().cycle());
        tasks.for_each(|((task, table), &ahead)| task.set_ahead(table, Ticks(ahead)));
        for (i, op) in ops.into_iter().enumerate() {
            prop_assert_eq!(other.step(op), plain.step(op), "step {}: {:?}", i, op);
        }
        for task in 0..plain.tasks.len() {
            prop_assert_eq!(other.tasks[task].next_expiry(), plain.tasks[task].next_expiry());
            prop_assert_eq!(other.bytes(task), plain.bytes(task));
        }
    }

    /// Checks that the kept deadline is never too late: before this deadline nothing is due, even if all parts are scanned.
    #[test]
    fn nothing_is_to_be_done_before_the_next_deadline(plan in plans(), ops in lively(), lags: [u8; 8]) {
        let mut plain = World::new(&plan.build(), true);
        let mut looking = plain.clone();
        (plain.splits, looking.splits, looking.looks_around) = (true, true, true);
        alike_with_lags([plain, looking], &ops, lags)?;
    }

    /// Compares an input at a later time with the passing of that time and then the same input: the effects must be the
    /// same.
    #[test]
    fn time_comes_before_what_it_comes_with(plan in plans(), ops in ops(), lags: [u8; 8]) {
        let together = World::new(&plan.build(), true);
        let mut apart = together.clone();
        apart.splits = true;
        alike_with_lags([together, apart], &ops, lags)?;
    }
}

/// Checks that two worlds have the same effects if some time passes before each operation.
fn alike_with_lags(mut worlds: [World; 2], ops: &[Op], lags: [u8; 8]) -> Result<(), TestCaseError> {
    let [one, other] = &mut worlds;
    for (i, &op) in ops.iter().enumerate() {
        let lag = u64::from(lags[i % lags.len()] % 16);
        (one.lag, other.lag) = (lag, lag);
        prop_assert_eq!(one.step(op), other.step(op));
        for task in 0..one.tasks.len() {
            prop_assert_eq!(one.bytes(task), other.bytes(task));
        }
    }
    Ok(())
}
