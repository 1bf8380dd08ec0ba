//! The pages about codes: a test compiles every example in them.

use imrs_language::codes::{ALL, explain};
use imrs_language::{Options, Source, compile_with, parse};

/// The codes of the parser's findings about a text.
fn codes(text: &str) -> Vec<&'static str> {
    match Source::new(text.as_bytes()) {
        Ok(source) => parse(&source).diagnostics.iter().map(|found| found.code).collect(),
        Err(found) => vec![found.code],
    }
}

/// The codes of all findings about a whole cell. Only the pages about syntax show parts of cells, for which `codes` is
/// used.
fn codes_of_cell(text: &str, paper: bool) -> Vec<&'static str> {
    let source = Source::new(text.as_bytes()).expect("a text");
    compile_with(&source, Options { paper }).diagnostics.iter().map(|found| found.code).collect()
}

/// The blocks of a page that are fenced with this word.
fn blocks<'p>(page: &'p str, fence: &str) -> Vec<&'p str> {
    let fence = format!("```cell,{fence}\n");
    let begins = page.split(&fence).skip(1);
    begins.map(|rest| rest.split("```").next().unwrap_or_default()).collect()
}

#[test]
fn every_example_of_every_page_is_what_it_says() {
    let mut surprising = Vec::new();
    for entry in ALL {
        let syntax = entry.code.starts_with("E0");
        let paper = entry.code == "E117";
        let codes = |text| if syntax { codes(text) } else { codes_of_cell(text, paper) };
        let (wrong, right) = (blocks(entry.explanation, "wrong"), blocks(entry.explanation, "right"));
        assert_eq!(wrong.len(), right.len(), "{}", entry.code);
        for text in wrong {
            let found = codes(text);
            if found != [entry.code] {
                surprising.push(format!("{}: {found:?} in the wrong example:\n{text}", entry.code));
            }
        }
        for text in right {
            let found = codes(text);
            if !found.is_empty() {
                surprising.push(format!("{}: {found:?} in the right example:\n{text}", entry.code));
            }
        }
    }
    assert!(surprising.is_empty(), "{}", surprising.join("\n"));
}

#[test]
fn codes_are_sorted_and_have_a_page_each() {
    assert!(ALL.is_sorted_by(|a, b| a.code < b.code));
    for entry in ALL {
        let heading = format!("# {}: {}\n", entry.code, entry.title);
        assert!(entry.explanation.starts_with(&heading), "{}", entry.code);
        assert!(entry.explanation.len() > heading.len() + 40, "{} is not explained", entry.code);
    }
    assert_eq!(explain("e007").map(|entry| entry.code), Some("E007"));
    assert_eq!(explain("E999"), None);
}

/// Each error and warning says what to write instead.
#[test]
fn every_error_and_warning_says_what_to_write() {
    let mut mute = Vec::new();
    // The messages of these codes already say what to write: `expected ..`, `choose another name`.
    let plain = ["E005", "E006", "E009"];
    let serious = ALL.iter().filter(|entry| !entry.code.starts_with('N') && !plain.contains(&entry.code));
    for entry in serious {
        for text in blocks(entry.explanation, "wrong") {
            let source = Source::new(text.as_bytes()).expect("a text");
            let found = match entry.code.starts_with("E0") {
                true => parse(&source).diagnostics,
                false => compile_with(&source, Options { paper: entry.code == "E117" }).diagnostics,
            };
            let silent = found.iter().filter(|found| found.help.is_empty());
            mute.extend(silent.map(|found| format!("{}: {}", found.code, found.message)));
        }
    }
    assert!(mute.is_empty(), "without help: {mute:#?}");
}
