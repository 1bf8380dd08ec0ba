//! Checks that the crates import each other only as the picture in ARCHITECTURE.md shows. The imports come from cargo.

use crate::support::metadata;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// For each package of the workspace: its dependencies, and its development dependencies.
fn imports() -> BTreeMap<String, (BTreeSet<String>, BTreeSet<String>)> {
    let metadata = metadata();
    let mut packages = BTreeMap::new();
    for package in metadata["packages"].as_array().expect("packages") {
        let of_kind = |dev: bool| {
            let dependencies = package["dependencies"].as_array().expect("dependencies").iter();
            let wanted = dependencies.filter(|d| (d["kind"] == "dev") == dev);
            wanted.map(|d| d["name"].as_str().expect("a name").to_owned()).collect()
        };
        let name = package["name"].as_str().expect("a name").to_owned();
        packages.insert(name, (of_kind(false), of_kind(true)));
    }
    packages
}

#[test]
fn the_crates_import_each_other_only_along_the_arrows() {
    let allowed: BTreeMap<&str, &[&str]> = BTreeMap::from([
        ("imrs-protocol", &[][..]),
        ("imrs-language", &["imrs-protocol"][..]),
        ("imrs-wire", &["imrs-protocol"][..]),
        ("imrs-model", &["imrs-protocol", "imrs-wire"][..]),
        ("imrs-runtime", &["imrs-protocol", "imrs-wire"][..]),
        ("imrs-client", &["imrs-protocol", "imrs-language", "imrs-wire", "imrs-runtime"][..]),
        ("imrs-launch", &["imrs-protocol", "imrs-language", "imrs-wire", "imrs-runtime", "imrs-client"][..]),
        ("imrs-monitor", &["imrs-protocol", "imrs-wire"][..]),
        ("imrs-macros", &["imrs-protocol", "imrs-language"][..]),
        ("imrs-testkit", &["imrs-protocol"][..]),
        ("imrs-bench", &["imrs-protocol", "imrs-wire", "imrs-runtime", "imrs-monitor"][..]),
        (
            "imrs",
            &[
                "imrs-protocol",
                "imrs-language",
                "imrs-wire",
                "imrs-model",
                "imrs-runtime",
                "imrs-client",
                "imrs-launch",
                "imrs-monitor",
                "imrs-bench",
            ][..],
        ),
    ]);
    let imports = imports();
    for (package, (normal, dev)) in &imports {
        let Some(allowed) = allowed.get(package.as_str()) else {
            panic!("`{package}` is new here: say in ARCHITECTURE.md and in this test what it may import")
        };
        // Tests may import more crates. The checker's tests compile cells. The macros' tests and the programs of
        // `examples/` run the generated code of the macros.
        let tested_with = |name: &String| {
            let both = (package.as_str(), name.as_str());
            [
                ("imrs-model", "imrs-language"),
                ("imrs-macros", "imrs-runtime"),
                ("imrs", "imrs-macros"),
                ("imrs-protocol", "imrs-testkit"),
                ("imrs-language", "imrs-testkit"),
            ]
            .contains(&both)
        };
        let dev = dev.iter().filter(|name| !tested_with(name));
        for name in normal.iter().chain(dev).filter(|name| imports.contains_key(*name)) {
            assert!(allowed.contains(&name.as_str()), "{package} must not import {name}");
        }
    }
}

#[test]
fn heavy_libraries_stay_in_their_crates() {
    for (package, (normal, dev)) in imports() {
        for (library, owner) in [
            ("stateright", "imrs-model"),
            ("ratatui", "imrs-monitor"),
            ("crossterm", "imrs-monitor"),
            ("clap", "imrs"),
            ("indicatif", "imrs"),
            ("zenoh", "imrs"),
        ] {
            let uses = normal.contains(library) || dev.contains(library);
            // The measurements have a command line of their own, and compare with zenoh.
            let measures = package == "imrs-bench" && ["clap", "zenoh"].contains(&library);
            assert!(!uses || package == owner || measures, "{library} in {package}: it belongs in {owner}");
        }
        for explorer in ["loom", "shuttle"] {
            assert!(!normal.contains(explorer), "{package}: {explorer} is for tests");
            assert!(
                !dev.contains(explorer) || package == "imrs-runtime",
                "{package}: {explorer} is for the runtime's tests"
            );
        }
    }
}

/// The names of all packages from which a package with these features is built; `known` must be among them.
fn tree_of(package: &str, features: &str, known: &str) -> Vec<String> {
    let tree = versions_of(package, features, known);
    tree.into_iter().map(|(name, _)| name).collect()
}

/// The names with their versions, on one kind of processor, of all packages from which a package with these features is
/// built.
fn versions_of(package: &str, features: &str, known: &str) -> Vec<(String, String)> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "-p", package, "-e", "normal,build", "--prefix", "none", "--offline"])
        .args(["--features", features, "--target", "x86_64-unknown-linux-gnu"])
        .current_dir(ROOT)
        .output()
        .expect("cargo tree");
    let tree = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && tree.contains(known), "{}", String::from_utf8_lossy(&output.stderr));
    let words = tree.lines().map(|line| line.split(' '));
    words.filter_map(|mut words| Some((words.next()?.to_owned(), words.next()?.to_owned()))).collect()
}

/// Each package that is linked into a robot's program takes time to build, and its authors must be trusted. A package
/// that is built in two versions is listed twice.
#[test]
fn a_robots_program_is_built_from_the_packages_that_are_listed() {
    let packages: BTreeSet<_> = versions_of("imrs-client", "", "imrs-protocol").into_iter().collect();
    let names: String = packages.iter().map(|(name, _)| format!("{name}\n")).collect();
    let list = Path::new(ROOT).join("client/packages.txt");
    if std::env::var_os("IMRS_BLESS").is_some() {
        fs::write(&list, &names).expect("the list is written");
    }
    let listed = fs::read_to_string(&list).expect("the list");
    assert_eq!(names, listed, "{}: IMRS_BLESS=1 writes what is built now", list.display());
}

#[test]
fn robots_carry_no_model_checker_and_no_screen() {
    let absent = [
        "stateright",
        "ratatui",
        "crossterm",
        "clap",
        "indicatif",
        "loom",
        "imrs-model",
        "imrs-monitor",
        "imrs-testkit",
        "imrs",
    ];
    // The launcher must not depend on the crate `imrs` either, because the launcher prints nothing.
    for package in ["imrs-runtime", "imrs-client", "imrs-launch"] {
        for name in tree_of(package, "", "imrs-protocol").iter().skip(1) {
            assert!(!absent.contains(&name.as_str()), "{package} brings {name} along");
        }
    }
}

#[test]
fn the_command_is_built_without_what_it_is_measured_against() {
    let peers =
        ["tokio", "kameo", "ractor", "actix", "crossbeam-channel", "flume", "kanal", "rtrb", "zeromq"];
    let default = tree_of("imrs", "", "imrs-model");
    assert!(!default.contains(&"imrs-bench".to_owned()), "the default build contains the measurements");
    for name in default.iter().chain(&tree_of("imrs", "bench", "imrs-bench")) {
        assert!(!peers.contains(&name.as_str()), "the command brings {name} along");
        assert!(!name.starts_with("zenoh"), "the feature `zenoh` alone may bring {name} along");
    }
}

#[test]
fn the_protocol_stands_alone() {
    let (normal, _) = &imports()["imrs-protocol"];
    assert!(normal.len() <= 3, "the protocol's dependencies: {normal:?}");
    let source = fs::read_to_string(Path::new(ROOT).join("protocol/src/lib.rs")).expect("its source");
    assert!(source.contains("#![no_std]") && source.contains("#![forbid(unsafe_code)]"));
    for package in ["model", "monitor"] {
        let source =
            fs::read_to_string(Path::new(ROOT).join(package).join("src/lib.rs")).expect("its source");
        assert!(source.contains("#![forbid(unsafe_code)]"), "{package} needs no unsafe code");
    }
}
