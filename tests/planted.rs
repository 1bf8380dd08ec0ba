//! Checks the list of faults that `.ci/planted` plants into the protocol. Each fault must still fit its file, because
//! otherwise it would not test the checker.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// The least number of faults in the list. Fewer faults would test the claims too little.
const FEWEST: usize = 80;

struct Fault {
    title: String,
    claim: String,
    file: String,
    old: String,
    new: String,
}

/// The list of faults, parsed as `.ci/planted` parses it.
fn faults() -> Vec<Fault> {
    let list = fs::read_to_string(Path::new(ROOT).join("model/planted.txt")).expect("the list");
    list.split("\n# ").skip(1).map(fault).collect()
}

fn fault(block: &str) -> Fault {
    let title = block.lines().next().unwrap_or_default().trim().to_owned();
    let field = |name: &str| {
        let found: Vec<_> = block.lines().filter_map(|line| line.strip_prefix(name)).collect();
        assert_eq!(found.len(), 1, "{title}: {name}");
        found[0].to_owned()
    };
    let part = |sign: &str| -> String {
        let lines = block.lines().filter(|line| line.starts_with(sign));
        lines.map(|line| format!("{}\n", line.get(2..).unwrap_or_default())).collect()
    };
    let (claim, file, old, new) = (field("claim: "), field("file: "), part("-"), part("+"));
    Fault { title, claim, file, old, new }
}

#[test]
fn every_planted_fault_fits_its_file_exactly_once() {
    let faults = faults();
    assert!(faults.len() >= FEWEST, "only {} faults", faults.len());
    let (mut titles, mut changes) = (BTreeSet::new(), BTreeSet::new());
    for Fault { title, claim, file, old, new } in faults {
        let text = fs::read_to_string(Path::new(ROOT).join(&file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert!(!old.is_empty() && old != new, "{title}: changes nothing");
        assert_eq!(text.matches(&old).count(), 1, "{title}: its lines in {file}");
        // Two words are no claims of the protocol: `guard` is the random cells of model/tests/guard, `fused` those of protocol/tests/fused.rs.
        let is_known =
            ["guard", "fused"].contains(&&*claim) || imrs_model::claim_names().contains(&claim.as_str());
        assert!(is_known, "{title}: no claim is named {claim}");
        assert!(titles.insert(title.clone()), "{title}: twice");
        assert!(changes.insert((file, old, new)), "{title}: the same change as another");
    }
}
