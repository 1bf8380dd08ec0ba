//! Runs the fuzz targets of `fuzz/` on random bytes and on their kept inputs.

#[path = "../../fuzz/seeds.rs"]
mod seeds;

use crate::support::bytes::{fused, inputs, packets};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_packets_or_errors(data in proptest::collection::vec(any::<u8>(), 0..400)) {
        packets(&data);
    }

    #[test]
    fn random_bytes_are_inputs(data in proptest::collection::vec(any::<u8>(), 0..900)) {
        inputs(&data);
    }

    #[test]
    fn random_bytes_are_fused_as_small_steps(data in proptest::collection::vec(any::<u8>(), 0..900)) {
        fused(&data);
    }
}

/// Runs every kept input of a target; if an input fails, the message names it.
pub fn replay(target: &str, run: fn(&[u8])) {
    let seeds = seeds::seeds(target);
    assert!(seeds.len() > 20, "{target} has {} kept inputs only", seeds.len());
    for (name, data) in seeds {
        let outcome = std::panic::catch_unwind(|| run(&data));
        assert!(outcome.is_ok(), "{target} {name}");
    }
}

#[test]
fn kept_packets_are_harmless() {
    replay("packet_decode", packets);
}

#[test]
fn kept_inputs_are_harmless() {
    replay("handle", inputs);
}

#[test]
fn kept_steps_are_fused_as_small_steps() {
    replay("fused", fused);
}
