//! Compares fused steps with the small steps that they stand for, on random cells: after every input, state, signals
//! and observations must be equal (D176, D200). `fuzzing.rs` does so on any bytes.

use crate::support::fused::{Counts, Op, Run};
use crate::support::plan::{Plan, plans};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

#[test]
fn a_fused_step_equals_the_small_steps() {
    let (mut runner, mut counts) = (TestRunner::deterministic(), Counts::new());
    let ops = proptest::collection::vec(any::<Op>(), 200);
    let shapes = proptest::collection::vec(any::<[u8; 6]>(), 1..5);
    for round in 0..1200_u32 {
        // Most cells have one node and the decided rules; every fourth cell may be any cell.
        let plan = if round % 4 == 0 {
            plans().new_tree(&mut runner).expect("a plan").current()
        } else {
            let shapes = shapes.new_tree(&mut runner).expect("ports").current();
            Plan::new([(round % 4) as u8, 0, 0], shapes, [0; 4], 0)
        };
        let mut run = Run::new(&plan);
        for op in ops.new_tree(&mut runner).expect("operations").current() {
            run.step(op, &mut counts);
        }
    }
    let singles = ["command", "status", "query", "reply", "response", "arrival", "meeting", "get"];
    let least = singles.map(|kind| (kind, 1000)).into_iter();
    for (kind, least) in least.chain([("reply and get", 1000), ("reply and message", 60)]) {
        let times = counts.get(kind).copied().unwrap_or_default();
        assert!(times >= least, "{kind}: only {times} of {counts:?}");
    }
}
