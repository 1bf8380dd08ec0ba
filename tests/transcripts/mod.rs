//! Executes the pages of `specs/protocol`. Each page has the rules that a user of the protocol can observe, and a
//! transcript that shows each rule. `IMRS_BLESS=1` writes the observed events into the pages.

mod cells;
mod drive;
mod look;
mod page;
mod steps;
mod tokens;
mod words;

use std::fs;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("specs/protocol")
}

fn check(page: &str) {
    let path = folder().join(format!("{page}.md"));
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let report = page::run(&format!("specs/protocol/{page}.md"), &text);
    if std::env::var_os("IMRS_BLESS").is_some() && report.blessed != text {
        fs::write(&path, &report.blessed).expect("a page that can be written");
    }
    assert!(report.shown > 0, "{page}.md shows nothing");
    assert!(report.faults.is_empty(), "\n\n{}\n", report.faults.join("\n\n"));
}

macro_rules! pages {
    ($($page:ident $file:literal)*) => {
        const PAGES: &[&str] = &[$($file),*];
        $(#[test] fn $page() { check($file); })*
    };
}

pages! {
    messages "messages"
    outcomes "outcomes"
    copies "copies"
    buffers "buffers"
    relays "relays"
    rendezvous "rendezvous"
    queries "queries"
    sets "sets"
    order "order"
    fragments "fragments"
    third_party_replies "third-party-replies"
    timers "timers"
    takeover "takeover"
    declarations "declarations"
}

#[test]
fn every_page_is_carried_out() {
    for entry in fs::read_dir(folder()).expect("the pages").flatten() {
        let name = entry.file_name().into_string().expect("a plain name");
        let page = name.strip_suffix(".md").unwrap_or_else(|| panic!("{name} is no page"));
        assert!(PAGES.contains(&page), "{name} is not in the list of `pages!`");
    }
}

/// The runner reports each fault of a page with its line, and accepts a page after it has written the observed events
/// into it.
#[test]
fn a_page_that_is_wrong_says_where() {
    let page = "# T\n```cell\nnode n\ntask A, B on n\nport p: A sends to B, time_out 9, colour red\n```\n\
                ```transcript\nA: send p \"x\"\n    A <- Refused   # no\nB: receive p\n```\n";
    let faults = page::run("t.md", page).faults;
    assert_eq!(faults[0], "t.md:5: `colour` is no option of a port");
    let page = page.replace(", colour red", "");
    let report = page::run("t.md", &page);
    assert_eq!(
        report.faults,
        [
            "t.md:8: after `A: send p \"x\"`\n  expected\n    A <- Refused\n  but saw\n    A <- accepted",
            "t.md:10: after `B: receive p`\n  expected\n    nothing\n  but saw\n    B <- \"x\" from A on p, 9 left",
        ]
    );
    assert_eq!(page::run("t.md", &report.blessed).faults, [""; 0]);
    let unknown = page.replace("receive p", "receive q");
    assert_eq!(page::run("t.md", &unknown).faults[1], "t.md:10: `q` is one word too many");
    let misplaced = page.replace("A: send p \"x\"\n", "");
    assert_eq!(
        page::run("t.md", &misplaced).faults[0],
        "t.md:8: this stands below no line that makes it happen"
    );
}
