//! Suggestions for misspelt names.

use std::collections::BTreeSet;

/// The end of an error message about an unknown name: ": did you mean `x`?" with the most similar name, or the list of all.
pub fn did_you_mean<'a>(wanted: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = names.into_iter().collect();
    let mut seen = BTreeSet::new();
    names.retain(|name| seen.insert(*name));
    let likeness = |name: &&&str| (strsim::jaro_winkler(wanted, name) * 1000.0).round() as u32;
    match names.iter().max_by_key(likeness).filter(|best| likeness(best) > 700) {
        Some(best) => format!(": did you mean `{best}`?"),
        None if names.is_empty() => ": there are none".into(),
        None => format!(": there are {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_is_recognised_and_anything_else_gets_the_list() {
        let names = ["no-false-release", "pairing", "at-most-once"];
        assert_eq!(did_you_mean("no-false-relese", names), ": did you mean `no-false-release`?");
        let twice = names.into_iter().chain(names);
        assert_eq!(did_you_mean("xyz", twice), ": there are no-false-release, pairing, at-most-once");
        assert_eq!(did_you_mean("xyz", []), ": there are none");
        assert_eq!(did_you_mean("xyz", names), ": there are no-false-release, pairing, at-most-once");
    }
}
