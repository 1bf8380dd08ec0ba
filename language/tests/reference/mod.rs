//! The language reference, `specs/language`: every cell in it compiles with the findings that the page shows, the page of
//! codes is the one that the compiler has, and the parser accepts whatever the grammar can produce.
//!
//! `IMRS_BLESS=1` rewrites the pages to the actual output; look at the difference before you keep it.

mod codes;
mod grammar;
mod pages;

use std::path::{Path, PathBuf};

/// The paths of the reference's pages, sorted.
fn pages() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../specs/language");
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the reference")
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    found.sort();
    assert!(found.len() >= 8, "the reference was not found: {found:?}");
    found
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Compares a page with the text that it should have; with `IMRS_BLESS=1`, writes that text.
#[track_caller]
fn same(path: &Path, should: &str) {
    let is = std::fs::read_to_string(path).unwrap_or_default();
    if is == should {
        return;
    }
    if std::env::var_os("IMRS_BLESS").is_some() {
        return std::fs::write(path, should).expect("a page");
    }
    let line = is.lines().zip(should.lines()).take_while(|(a, b)| a == b).count();
    let at = |text: &str| text.lines().skip(line).take(12).collect::<Vec<_>>().join("\n");
    let name = path.file_name().unwrap_or_default().display();
    let (was, now) = (at(&is), at(should));
    panic!("{name}:{}: says\n{was}\n\nbut it is\n{now}\n\n`IMRS_BLESS=1` writes it", line + 1);
}
