//! House rules that a reader would otherwise have to enforce.

use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const ROOMS: [&str; 12] = [
    "src", "tests", "examples", "protocol", "language", "wire", "model", "runtime", "macros", "monitor",
    "benches", "fuzz",
];
/// Longer files want to be two.
const LONGEST_FILE: usize = 600;

/// Every Rust file of the workspace, with its text.
fn sources() -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = ROOMS.iter().map(|room| Path::new(ROOT).join(room)).collect();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a source file");
                found.push((path, text));
            }
        }
    }
    assert!(found.len() > 30, "the sources were not found: {found:?}");
    found
}

#[test]
fn files_stay_short_enough_to_be_read() {
    let long: Vec<_> = sources()
        .into_iter()
        .map(|(path, text)| (path, text.lines().count()))
        .filter(|(_, lines)| *lines > LONGEST_FILE)
        .collect();
    assert!(long.is_empty(), "longer than {LONGEST_FILE} lines: {long:#?}");
}

#[test]
fn nothing_is_left_out_or_left_for_later() {
    // Put together here, so that this file does not find itself.
    let unwanted = [
        concat!("#[ig", "nore"),
        concat!("to", "do!("),
        concat!("unimp", "lemented!("),
        concat!("FIX", "ME"),
    ];
    for (path, text) in sources() {
        for (number, line) in text.lines().enumerate() {
            for word in unwanted {
                assert!(!line.contains(word), "{}:{}: {}", path.display(), number + 1, line.trim());
            }
        }
    }
}

#[test]
fn words_promise_no_more_than_is_so() {
    let unwanted = [concat!("safety", "-rated"), concat!("fail", "-safe"), concat!("SI", "L-")];
    let documents = ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"];
    let texts = documents
        .map(|name| (PathBuf::from(name), fs::read_to_string(Path::new(ROOT).join(name)).expect(name)));
    for (path, text) in sources().into_iter().chain(texts) {
        for word in unwanted {
            // To say that it is not so is allowed.
            let claims = text.lines().find(|l| l.contains(word) && !l.contains("no ") && !l.contains("not "));
            assert_eq!(claims, None, "{}", path.display());
        }
    }
}
