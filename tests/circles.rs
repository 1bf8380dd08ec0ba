//! The import graph of the files of each crate has no cycle, so each file can be read and tested after the files that
//! it imports. A file that names the files of its folder by their bare names counts as one file with them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::iter::Peekable;
use std::path::Path;
use std::str::Chars;

const CRATES: [&str; 11] = [
    "src",
    "protocol/src",
    "language/src",
    "wire/src",
    "model/src",
    "runtime/src",
    "client/src",
    "launch/src",
    "monitor/src",
    "macros/src",
    "testkit/src",
];

/// The path of a module: its names below `crate`.
type Module = Vec<String>;

/// The modules of a crate with their code, without comments and unit tests.
fn modules_of(folder: &Path) -> BTreeMap<Module, String> {
    let mut modules = BTreeMap::new();
    let mut folders = vec![(folder.to_owned(), Module::new())];
    while let Some((folder, module)) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of a crate").flatten() {
            let path = entry.path();
            let name = path.file_stem().expect("a name").to_str().expect("UTF-8").to_owned();
            let own = [&module[..], std::slice::from_ref(&name)].concat();
            if path.is_dir() {
                folders.push((path, own));
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let is_of_folder = ["mod", "lib", "main"].contains(&name.as_str());
                let own = if is_of_folder { module.clone() } else { own };
                modules.insert(own, code(&fs::read_to_string(&path).expect("a source file")));
            }
        }
    }
    modules
}

fn code(text: &str) -> String {
    let own = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    own.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// The paths in the code that begin with `crate`, `super` or `self`.
fn paths(code: &str) -> BTreeSet<Module> {
    let (mut found, mut rest) = (BTreeSet::new(), code.chars().peekable());
    let mut is_begin = true;
    while let Some(&next) = rest.peek() {
        if !is_word(next) {
            // A word after `::` or `.` continues a path, and does not begin one.
            is_begin = !matches!(next, ':' | '.' | '\'');
            rest.next();
            continue;
        }
        let first = word(&mut rest);
        if is_begin && ["crate", "super", "self"].contains(&first.as_str()) {
            path(vec![first], &mut rest, &mut found);
        }
        is_begin = false;
    }
    found
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn word(rest: &mut Peekable<Chars<'_>>) -> String {
    std::iter::from_fn(|| rest.next_if(|&c| is_word(c))).collect()
}

fn space(rest: &mut Peekable<Chars<'_>>) {
    while rest.next_if(|c| c.is_whitespace()).is_some() {}
}

/// Reads the rest of a path: more names, or several endings in braces.
fn path(mut own: Module, rest: &mut Peekable<Chars<'_>>, found: &mut BTreeSet<Module>) {
    while rest.peek() == Some(&':') {
        rest.next();
        if rest.next_if_eq(&':').is_none() {
            break;
        }
        space(rest);
        if rest.next_if_eq(&'{').is_some() {
            return ends(&own, rest, found);
        }
        match word(rest) {
            next if next.is_empty() => break,
            next => own.push(next),
        }
    }
    found.insert(own);
}

fn ends(own: &Module, rest: &mut Peekable<Chars<'_>>, found: &mut BTreeSet<Module>) {
    loop {
        space(rest);
        match rest.peek() {
            Some(&next) if is_word(next) => {
                let end = [&own[..], &[word(rest)]].concat();
                path(end, rest, found);
                // Skips a renaming: `as another`.
                while rest.next_if(|&c| c != ',' && c != '}').is_some() {}
            }
            Some('}') | None => {
                rest.next();
                return;
            }
            Some(_) => {
                rest.next();
            }
        }
    }
}

/// The module to which a path in the module `own` leads, unless that is `own` itself or the root.
fn file(path: &Module, own: &Module, modules: &BTreeMap<Module, String>) -> Option<Module> {
    let mut at: Module = if path[0] == "crate" { Module::new() } else { own.clone() };
    for step in path {
        match step.as_str() {
            "crate" | "self" => {}
            "super" => drop(at.pop()),
            name => at.push(name.to_owned()),
        }
    }
    while !at.is_empty() && !modules.contains_key(&at) {
        at.pop();
    }
    (!at.is_empty() && at != *own).then_some(at)
}

/// The modules that are in import cycles. For each of them: its imports within the cycles.
fn circles(modules: &BTreeMap<Module, String>) -> BTreeMap<Module, BTreeSet<Module>> {
    let imports = |(own, code): (&Module, &String)| {
        let others: BTreeSet<Module> =
            paths(code).iter().filter_map(|path| file(path, own, modules)).collect();
        (own.clone(), others)
    };
    let mut left: BTreeMap<Module, BTreeSet<Module>> = modules.iter().map(imports).collect();
    // A module that imports no remaining module, or that none imports, is in no cycle.
    loop {
        let before = left.len();
        let imported: BTreeSet<Module> = left.values().flatten().cloned().collect();
        left.retain(|own, others| !others.is_empty() && imported.contains(own));
        let known: BTreeSet<Module> = left.keys().cloned().collect();
        left.values_mut().for_each(|others| others.retain(|other| known.contains(other)));
        if left.len() == before {
            return left;
        }
    }
}

#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    for name in CRATES {
        let modules = modules_of(&Path::new(env!("CARGO_MANIFEST_DIR")).join(name));
        assert!(modules.len() > 1, "{name}: no files were found");
        let line = |(own, others): (&Module, &BTreeSet<Module>)| {
            let others: Vec<String> = others.iter().map(|other| other.join("::")).collect();
            format!("{} imports {}", own.join("::"), others.join(", "))
        };
        let found: Vec<String> = circles(&modules).iter().map(line).collect();
        assert!(found.is_empty(), "{name} has a circle:\n{}", found.join("\n"));
    }
}

#[test]
fn a_circle_is_found_whatever_way_its_imports_are_written() {
    let found = |files: &[(&str, &str)]| {
        let modules = files.iter().map(|(module, text)| {
            (module.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect(), code(text))
        });
        circles(&modules.collect()).keys().map(|module| module.join("::")).collect::<Vec<_>>().join(" ")
    };
    let b = ("b", "use crate::{c::{C, D as E}, other};");
    assert_eq!(
        found(&[("a", "use super::b;"), b, ("c", "fn f() -> crate::a::A { g() }"), ("d", "")]),
        "a b c"
    );
    assert_eq!(found(&[("a", "use super::b;"), b, ("c", "// crate::a"), ("d", "use crate::a;")]), "");
    assert_eq!(
        found(&[("a", "use self::x::X;"), ("a::x", "use super::A;"), ("", "use crate::a;")]),
        "a a::x"
    );
    assert_eq!(found(&[("a", "mod x; use x::X;"), ("a::x", "use super::A;")]), "");
    assert_eq!(found(&[("a", "use crate::b;"), ("b", "#[cfg(test)]\nmod tests { use crate::a; }")]), "");
}
