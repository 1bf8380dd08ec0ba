//! Runs the check of the fuzz target `obs` on random bytes and on the kept inputs.

#[path = "../../fuzz/seeds.rs"]
mod kept;

use crate::support::bytes::check;
use proptest::prelude::*;

proptest! {
    #[test]
    fn any_bytes_are_borne(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        check(&bytes);
    }

    /// Checks valid streams of frames in which some bytes were changed.
    #[test]
    fn damaged_streams_are_borne(which in any::<usize>(), damage in proptest::collection::vec((any::<usize>(), any::<u8>()), 0..6)) {
        let seeds = seeds();
        let mut bytes = seeds[which % seeds.len()].clone();
        for (at, value) in damage {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        check(&bytes);
    }
}

#[test]
fn kept_inputs_are_borne() {
    seeds().iter().for_each(|bytes| check(bytes));
}

fn seeds() -> Vec<Vec<u8>> {
    let seeds: Vec<_> = kept::seeds("obs").into_iter().map(|(_, bytes)| bytes).collect();
    assert!(!seeds.is_empty());
    seeds
}
