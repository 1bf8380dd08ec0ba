//! Tests that computing with symbolic durations gives the same as computing with their numbers.

use super::{Evaluate, on_symbols};
use imrs_protocol::*;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use std::cmp::Ordering;

/// Several results, computed from a plain duration and three durations between variables, each moved by an offset.
fn computed(between: impl Fn(u8, u8) -> Ticks, parts: &[(u8, u8, i64)], plain: Ticks) -> [Ticks; 11] {
    let [a, b, c] = [0, 1, 2].map(|at| {
        let (first, second, offset) = parts[at];
        let moved = Ticks(offset.unsigned_abs());
        if offset < 0 { between(first, second) - moved } else { between(first, second) + moved }
    });
    let half = Ticks(a.whole(Ticks(2)));
    [a, b, c, a + b, a - b, (a + b) - c, a.max(b), a.min(b), plain + c, plain - c, half]
}

/// The results of all comparisons of all pairs of times.
fn compared(times: &[Ticks]) -> Vec<(bool, bool, Ordering, bool)> {
    let pairs = times.iter().flat_map(|one| times.iter().map(move |other| (one, other)));
    pairs.map(|(one, other)| (one < other, one >= other, one.cmp(other), one == other)).collect()
}

#[test]
fn saturated_symbols_compare_as_their_numbers() {
    let numbers = proptest::collection::vec(0..6_i64, 4);
    let times = (numbers, proptest::collection::vec((0..4_u8, 0..4_u8, -4..5_i64), 3), 0..6_u64);
    let config = ProptestConfig { cases: 4_000, failure_persistence: None, ..ProptestConfig::default() };
    let result = TestRunner::new(config).run(&times, |(mut values, parts, plain)| {
        values[0] = 0;
        let plainly = |variable: u8| Ticks(values[usize::from(variable)].unsigned_abs());
        let numbers = computed(|first, second| plainly(first) - plainly(second), &parts, Ticks(plain));
        let ((symbols, compared), zone) = on_symbols(&values[1..], || {
            let symbols = computed(symbolic::between, &parts, Ticks(plain));
            (symbols, compared(&symbols))
        });
        let evaluate = Evaluate(&zone);
        prop_assert_eq!(symbols.map(|symbol| Ticks(evaluate.value_of(symbol.0))), numbers);
        prop_assert_eq!(compared, self::compared(&numbers));
        Ok(())
    });
    result.unwrap_or_else(|error| panic!("{error}"));
}
