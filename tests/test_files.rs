//! Checks that every test file is compiled. Cargo does not search for test programs in this workspace, so a file that
//! no `mod` declares would silently be ignored.

use crate::support::metadata;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The root files of all test programs, and all folders named `tests`, according to cargo.
fn programs_and_folders() -> (Vec<PathBuf>, Vec<PathBuf>) {
    let metadata = metadata();
    let path = |value: &Value| PathBuf::from(value.as_str().expect("a path"));
    let (mut programs, mut folders) = (Vec::new(), Vec::new());
    for package in metadata["packages"].as_array().expect("packages") {
        let targets = package["targets"].as_array().expect("targets").iter();
        programs.extend(targets.filter(|t| t["kind"][0] == "test").map(|t| path(&t["src_path"])));
        folders.push(path(&package["manifest_path"]).with_file_name("tests"));
    }
    folders.retain(|folder| folder.is_dir());
    (programs, folders)
}

/// All Rust files in a folder and in its subfolders.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let below = folders.iter().flat_map(|folder| rust_files(folder));
    files.into_iter().filter(|path| path.extension().is_some_and(|e| e == "rs")).chain(below).collect()
}

/// The canonical path of a file.
fn whole(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The module's name in a line such as `mod name;` or `pub mod name;`.
fn module(line: &str) -> Option<&str> {
    let (before, rest) = line.split_once("mod ")?;
    let visible = before.is_empty() || (before.starts_with("pub") && before.ends_with([' ', ')']));
    rest.strip_suffix(';').filter(|_| visible)
}

/// The files of the modules that a file declares. They are in the same folder if the file is a program's root, is named
/// by `#[path]`, or is a `mod.rs`. Otherwise they are in a folder with the file's name.
fn modules(file: &Path, beside: bool) -> Vec<(PathBuf, bool)> {
    let text = fs::read_to_string(file).expect("a source file");
    let here = file.parent().expect("a folder");
    let folder = if beside { here.to_owned() } else { file.with_extension("") };
    let (mut found, mut named) = (Vec::new(), None);
    for line in text.lines() {
        let line = line.trim();
        if let Some(path) = line.strip_prefix("#[path = \"").and_then(|rest| rest.strip_suffix("\"]")) {
            named = Some(here.join(path));
        } else if let Some(name) = module(line) {
            let flat = folder.join(format!("{name}.rs"));
            found.push(match named.take() {
                Some(path) => (whole(&path), true),
                None if flat.is_file() => (whole(&flat), false),
                None => (whole(&folder.join(name).join("mod.rs")), true),
            });
        } else if !line.starts_with("#[") && !line.starts_with("//") {
            named = None;
        }
    }
    found
}

#[test]
fn every_test_file_belongs_to_a_test_program() {
    let (programs, folders) = programs_and_folders();
    assert!(programs.len() >= 7 && folders.len() >= 7, "not found: {programs:?} {folders:?}");
    let mut waiting: Vec<_> = programs.iter().map(|program| (whole(program), true)).collect();
    let mut compiled = BTreeSet::new();
    while let Some((file, beside)) = waiting.pop() {
        if compiled.insert(file.clone()) {
            waiting.extend(modules(&file, beside));
        }
    }
    let files: BTreeSet<_> =
        folders.iter().flat_map(|folder| rust_files(folder)).map(|f| whole(&f)).collect();
    let forgotten: Vec<_> = files.difference(&compiled).collect();
    assert!(forgotten.is_empty(), "no `mod` names these, so they are not compiled: {forgotten:#?}");
}
