//! `imrs explain`: shows the pages about the codes of diagnostics, of the monitor's warnings, and of reasons for a drop.

mod reasons;

use crate::args::{ExplainArgs, Format};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::names::did_you_mean;
use crate::output::{BAD, FAINT, GOOD, HEAD, Output, Styled};
use imrs_language::{Word, codes};
use imrs_monitor::store::health::codes as lints;
use serde_json::json;

/// A code, and the page that explains it.
#[derive(Clone, Copy)]
struct Entry {
    code: &'static str,
    title: &'static str,
    explanation: &'static str,
}

/// All entries: the codes of `imrs check`, then the codes of `imrs monitor`, then the reasons for which a message is dropped.
fn entries() -> impl Iterator<Item = Entry> {
    let diagnostics =
        codes::ALL.iter().map(|of| Entry { code: of.code, title: of.title, explanation: of.explanation });
    let lints =
        lints::ALL.iter().map(|of| Entry { code: of.code, title: of.title, explanation: of.explanation });
    diagnostics.chain(lints).chain(reasons::ALL.iter().copied())
}

/// Explains one code, or lists all codes.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ExplainArgs, out: &mut Output) -> Result<Exit, Failure> {
    let entries: Vec<Entry> = match &args.code {
        None => entries().collect(),
        Some(code) => vec![page(code)?],
    };
    match args.format {
        Format::Json => {
            let pages = entries.iter().map(
                |entry| json!({"code": entry.code, "title": entry.title, "explanation": entry.explanation}),
            );
            out.json(&json!({"version": 1, "codes": pages.collect::<Vec<_>>()}))?;
        }
        Format::Text if args.code.is_none() => {
            for entry in entries {
                out.line(format!("{}  {}", Styled(HEAD, entry.code), entry.title))?;
            }
            out.line(
                "\nE is an error, W a warning, N a note of `imrs check`; those in words come from `imrs monitor`. Words with `_` are\n\
                 reasons for which a message is dropped. `imrs explain E104` shows one.",
            )?;
        }
        Format::Text => entries.iter().try_for_each(|entry| out.text(&shown(entry.explanation)))?,
    }
    Ok(Exit::Well)
}

fn page(code: &str) -> Result<Entry, Failure> {
    let upper = code.to_ascii_uppercase();
    let is_asked = |entry: &Entry| {
        entry.code.eq_ignore_ascii_case(code) || entry.code.eq_ignore_ascii_case(&code.replace('-', "_"))
    };
    if let Some(found) = entries().find(is_asked) {
        return Ok(found);
    }
    // The likeliest misspelling of a code is an O in place of a zero.
    let slip = upper.replace('O', "0");
    let near = did_you_mean(&slip, codes::ALL.iter().map(|entry| entry.code));
    let lower = code.to_ascii_lowercase();
    let near = if near.starts_with(": did") {
        near
    } else {
        did_you_mean(&lower, lints::ALL.iter().map(|l| l.code).chain(reasons::ALL.iter().map(|of| of.code)))
    };
    // The list of all codes is too long for an error message.
    let hint = if near.starts_with(": did") { near } else { ": `imrs explain` lists them".to_owned() };
    Err(Failure::Usage(format!("no code `{code}`{hint}")))
}

/// A page, formatted for a terminal. Pages use headings, paragraphs and fenced cells of Markdown.
fn shown(page: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut in_cell = false;
    for line in page.lines() {
        if let Some(fence) = line.strip_prefix("```") {
            in_cell = !in_cell;
            match fence {
                "cell,wrong" => lines.push(Styled(BAD, "Wrong:").to_string()),
                "cell,right" => lines.push(Styled(GOOD, "Right:").to_string()),
                _ => {}
            }
        } else if in_cell {
            lines.push(format!("    {}", cell(line)));
        } else if let Some(heading) = line.strip_prefix("# ") {
            lines.push(Styled(HEAD, heading).to_string());
        } else {
            lines.push(prose(line));
        }
    }
    lines.join("\n") + "\n"
}

/// A line of a cell, with highlighted keywords and comments.
fn cell(line: &str) -> String {
    let (code, comment) = line.split_at(line.find("//").unwrap_or(line.len()));
    let is_of_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut shown = String::new();
    let mut rest = code;
    while let Some(first) = rest.chars().next() {
        let end = rest.find(|c| is_of_word(c) != is_of_word(first)).unwrap_or(rest.len());
        let (piece, after) = rest.split_at(end);
        rest = after;
        match Word::find(piece) {
            Some(word) if word.is_reserved() => shown += &Styled(HEAD, piece).to_string(),
            Some(_) | None => shown += piece,
        }
    }
    if comment.is_empty() { shown } else { shown + &Styled(FAINT, comment).to_string() }
}

/// A line of a paragraph, with highlighted backtick spans.
fn prose(line: &str) -> String {
    let mut shown = String::new();
    for (at, piece) in line.split('`').enumerate() {
        match at % 2 {
            0 => shown += piece,
            _ => shown += &Styled(HEAD, format!("`{piece}`")).to_string(),
        }
    }
    shown
}
