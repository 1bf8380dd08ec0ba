//! Checks the lists of faults that `.ci/planted` plants into the protocol and into the search by zones. Each fault must
//! still fit its file, because otherwise it would not test the checker.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// The lists, and the least number of faults in each. Fewer faults would test the claims, or the search, too little.
const LISTS: [(&str, usize); 2] = [("planted", 80), ("planted-zones", 20)];

struct Fault {
    title: String,
    claim: String,
    file: String,
    old: String,
    new: String,
}

/// A list of faults, parsed as `.ci/planted` parses it.
fn faults(name: &str) -> Vec<Fault> {
    let list = fs::read_to_string(Path::new(ROOT).join(format!("model/{name}.txt"))).expect("the list");
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
    let (mut titles, mut changes) = (BTreeSet::new(), BTreeSet::new());
    let listed = LISTS.iter().flat_map(|&(name, fewest)| {
        let faults = faults(name);
        assert!(faults.len() >= fewest, "{name}: only {} faults", faults.len());
        faults
    });
    for Fault { title, claim, file, old, new } in listed {
        let text = fs::read_to_string(Path::new(ROOT).join(&file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert!(!old.is_empty() && old != new, "{title}: changes nothing");
        assert_eq!(text.matches(&old).count(), 1, "{title}: its lines in {file}");
        // Three words are no claims of the protocol but tests: `guard` is model/tests/guard, `fused` is protocol/tests/fused.rs, `zones` is
        // model/tests/zones.rs.
        let is_known = ["guard", "fused", "zones"].contains(&&*claim)
            || imrs_model::claim_names().contains(&claim.as_str());
        assert!(is_known, "{title}: no claim is named {claim}");
        assert!(titles.insert(title.clone()), "{title}: twice");
        assert!(changes.insert((file, old, new)), "{title}: the same change as another");
    }
}
