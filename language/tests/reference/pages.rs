//! Checks the cells in the pages of the reference.
//!
//! A block fenced as `cell` is a whole file, and `cell,paper` is one for `--paper`. A block fenced as `cell,NAME` is a part
//! that goes into a frame: a comment of the page, `<!-- frame NAME`, with a line `...` in place of the part. A block fenced
//! as `diagnostics` behind such a block lists its findings; without such a block it has no findings.

use super::{pages, read, same};
use imrs_language::{Options, Source, Unit, compile_with, render};
use std::collections::BTreeMap;

/// The frames of a page: for each name, the text in front of the part, and the text behind it.
fn frames(page: &str) -> BTreeMap<&str, (&str, &str)> {
    let comments = page.split("<!-- frame ").skip(1).filter_map(|rest| rest.split("\n-->").next());
    comments
        .map(|comment| {
            let (name, text) = comment.split_once('\n').expect("a frame's name on a line of its own");
            let (before, behind) = text.split_once("...\n").expect("a line `...` in the frame");
            (name.trim(), (before, behind))
        })
        .collect()
}

/// The findings about a part of a cell, with lines and columns counted within the part.
fn brief(text: &str, from: usize, paper: bool) -> String {
    let source = Source::new(text.as_bytes()).expect("a text");
    let mut said = String::new();
    for found in &compile_with(&source, Options { paper }).diagnostics {
        let (line, column) = source.position(found.primary.span.start);
        let line = line.checked_sub(from).filter(|line| *line > 0);
        let line = line.map_or_else(|| "elsewhere".to_owned(), |line| format!("{line}:{column}"));
        said += &format!("{line} {}[{}]: {}\n", word(found.code), found.code, found.message);
        if let Some(label) = Some(&found.primary.text).filter(|text| !text.is_empty()) {
            said += &format!("    here: {label}\n");
        }
        for help in &found.help {
            said += &format!("    help: {help}\n");
        }
    }
    said
}

fn word(code: &str) -> &'static str {
    match code.as_bytes().first() {
        Some(b'E') => "error",
        Some(b'W') => "warn",
        _ => "note",
    }
}

/// The findings about a whole file, as a user sees them.
fn full(text: &str, paper: bool) -> String {
    let source = Source::new(text.as_bytes()).expect("a text");
    let compiled = compile_with(&source, Options { paper });
    if compiled.hir.is_some() {
        for unit in [Unit::Microseconds, Unit::Ticks] {
            assert!(compiled.lower(unit).is_some(), "{text}");
        }
    }
    let shown = render::text(&compiled.diagnostics, "robot.cell", Some(&source), render::Style::Plain);
    // Trailing blanks are removed, because they would be invisible in a page.
    shown.lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

fn said_of(fence: &str, code: &str, frames: &BTreeMap<&str, (&str, &str)>, page: &str) -> String {
    let paper = fence == "cell,paper";
    match fence.strip_prefix("cell,") {
        None | Some("paper") => full(code, paper),
        Some(name) => {
            let (before, behind) = frames.get(name).unwrap_or_else(|| panic!("{page}: no frame `{name}`"));
            brief(&format!("{before}{code}{behind}"), before.lines().count(), false)
        }
    }
}

/// The page with the actual findings in its blocks of diagnostics, and the number of cells on the page.
fn checked(page: &str, name: &str) -> (String, usize) {
    let frames = frames(page);
    let lines: Vec<&str> = page.lines().collect();
    let (mut out, mut cells, mut at) = (String::new(), 0, 0);
    let end_of =
        |from: usize| (from..lines.len()).find(|&at| lines[at] == "```").expect("the end of a block");
    while at < lines.len() {
        out += &format!("{}\n", lines[at]);
        let fence = lines[at].strip_prefix("```").filter(|fence| fence.split(',').next() == Some("cell"));
        at += 1;
        let Some(fence) = fence else { continue };
        cells += 1;
        let end = end_of(at);
        let code: String = lines[at..end].iter().map(|line| format!("{line}\n")).collect();
        let said = said_of(fence, &code, &frames, name);
        out += &format!("{code}```\n");
        at = end + 1;
        // A block of diagnostics, if there is one, follows after an empty line.
        if lines.get(at) == Some(&"") && lines.get(at + 1) == Some(&"```diagnostics") {
            at = end_of(at + 2) + 1;
        }
        if !said.is_empty() {
            out += &format!("\n```diagnostics\n{said}```\n");
        }
    }
    (out, cells)
}

#[test]
fn every_cell_says_what_its_page_says() {
    let mut all = 0;
    for path in pages() {
        let page = read(&path);
        let (should, cells) = checked(&page, &path.display().to_string());
        same(&path, &should);
        all += cells;
    }
    assert!(all >= 20, "only {all} cells were found");
}
