//! Checks that the reference page of codes agrees with the compiler's own pages.

use super::same;
use imrs_language::codes::ALL;
use std::fmt::Write;
use std::path::Path;

const HEAD: &str = "# Codes

Each diagnostic of `imrs check` has a code, which begins with E for an error, W for a warning, and N for a note. A cell with an error is neither
run nor verified; a cell with warnings is. `imrs explain E104` explains a code, with a wrong cell and a right one. This page has the same texts.

One error does not hide others: the compiler checks all parts of a file that it could read, and leaves out diagnostics that may only follow from
another error. If it left out some, a last line says so (`unchecked` with `--format json`). The exit code is 1 if there are errors, and 2 if the
file exceeds a limit (E012, E123).

## What the paper asks of its compiler

| the paper (§3, §5) | code |
|---|---|
| each port has one number of its own | E101; a digest of the compiled cell, which every packet carries |
| a table of the tasks' places, for routing | E102, E205 |
| one port of two tasks | E103 |
| usages of the two ends fit | E105 |
| message_format of the two ends is equal | E108 |
| only listed tasks use a port, and all of them do | E106, E107 |
| a parameter is one word where nothing is said | E112, where it does not fit |
| where tasks are best placed, from their time_outs | E201, W318, E207, W315 |

The compiler also finds faults that the paper leaves to the programmer: calls in a ring (E202), rendezvous in different orders (E203) or without a member (E104, W314),
commands that no task takes or answers (E204, E209, W308), a bad outcome without a branch (E208, W301), buffers that are too small (W302),
work that keeps a message waiting too long (W303), a penalty that is too long (W306) or starves (W307), what is not reached or not used
(W309, W310, W311), time_outs of a few ticks (E206, N201), numbers that may come again (E304), a name
that means another variable in a handler than in the body (W319), leases (E305, E306), and statements that cannot be where they are (E113).
";

const KINDS: [(&str, &str); 7] = [
    ("E0", "Text"),
    ("E1", "Names, ports, types, statements"),
    ("E2", "What cannot work"),
    ("E3", "Time and leases"),
    ("N1", "Notes about the model"),
    ("N2", "Notes"),
    ("W3", "What mostly is not meant"),
];

/// The text in front of the examples of a page.
fn prose(page: &str) -> String {
    let body = page.split_once('\n').map_or("", |(_, rest)| rest);
    body.split("```").next().unwrap_or_default().trim().to_owned()
}

#[test]
fn the_page_of_codes_is_up_to_date() {
    let mut page = String::from(HEAD);
    for (prefix, title) in KINDS {
        let _ = write!(page, "\n## {title}\n");
        for entry in ALL.iter().filter(|entry| entry.code.starts_with(prefix)) {
            let _ = write!(page, "\n### {}: {}\n\n{}\n", entry.code, entry.title, prose(entry.explanation));
        }
    }
    let entries = page.lines().filter(|line| line.starts_with("### ")).count();
    assert_eq!(entries, ALL.len(), "a code of no kind");
    same(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../specs/language/codes.md"), &page);
}
