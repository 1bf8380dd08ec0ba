//! What the fuzz targets of `fuzz/` run, on random bytes and on the inputs that they found worth keeping.

mod support;

use proptest::prelude::*;
use std::fs;
use std::path::Path;
use support::bytes::{inputs, packets};

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
}

/// Runs every kept input of a target; says which one it was that failed.
fn replay(target: &str, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds").join(target);
    let mut count = 0;
    for entry in fs::read_dir(&folder).expect("kept inputs").flatten() {
        let data = fs::read(entry.path()).expect("an input");
        let outcome = std::panic::catch_unwind(|| run(&data));
        assert!(outcome.is_ok(), "{} {}", target, entry.path().display());
        count += 1;
    }
    assert!(count > 20, "{target} has {count} kept inputs only");
}

#[test]
fn kept_packets_are_harmless() {
    replay("packet_decode", packets);
}

#[test]
fn kept_inputs_are_harmless() {
    replay("handle", inputs);
}
