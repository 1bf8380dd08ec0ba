//! Any bytes, and the inputs that are kept, through what the fuzz target `obs` runs.

#[path = "support/bytes.rs"]
mod support;

use proptest::prelude::*;
use std::path::Path;

proptest! {
    #[test]
    fn any_bytes_are_borne(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        support::check(&bytes);
    }

    /// Streams of frames that once meant something, with some bytes changed.
    #[test]
    fn damaged_streams_are_borne(which in any::<usize>(), damage in proptest::collection::vec((any::<usize>(), any::<u8>()), 0..6)) {
        let seeds = seeds();
        let mut bytes = seeds[which % seeds.len()].clone();
        for (at, value) in damage {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        support::check(&bytes);
    }
}

#[test]
fn kept_inputs_are_borne() {
    seeds().iter().for_each(|bytes| support::check(bytes));
}

fn seeds() -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds/obs");
    let files = std::fs::read_dir(folder).expect("seeds");
    let seeds: Vec<_> = files.map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    assert!(!seeds.is_empty());
    seeds
}
