//! Runs a page of executable rules. A page has prose and three kinds of blocks. A `cell` block declares the cell for
//! the blocks after it. A `wrong` block is a cell that is rejected, followed by its faults. A `transcript` block starts
//! with fresh nodes; below each of its steps stand the events that were observed.

use super::cells::Declared;
use super::drive::{Drive, Seen};
use super::steps;
use std::fmt::Write;

/// The result of running one page.
#[derive(Default)]
pub struct Report {
    /// The page, with the events that were observed in this run.
    pub blessed: String,
    pub faults: Vec<String>,
    /// How many transcripts and rejected cells the page has.
    pub shown: usize,
}

/// One step of a transcript, and the lines of the page below it.
struct Entry<'a> {
    number: usize,
    line: &'a str,
    /// The lines below the step, up to the next one: expected events, remarks and empty lines.
    below: Vec<(usize, &'a str)>,
}

/// Runs a page. The faults that are reported start with `name`, the name of the page.
pub fn run(name: &str, page: &str) -> Report {
    let mut report = Report::default();
    let mut declared = Declared::default();
    let mut lines = page.lines().enumerate().map(|(i, line)| (i + 1, line));
    while let Some((_, line)) = lines.next() {
        report.line(line);
        if !matches!(line, "```cell" | "```wrong" | "```transcript") {
            continue;
        }
        let block: Vec<(usize, &str)> = lines.by_ref().take_while(|(_, line)| *line != "```").collect();
        match line {
            "```cell" => declared = cell(name, &block, &mut report),
            "```wrong" => wrong(name, &block, &mut report),
            _ => transcript(name, &declared, &block, &mut report),
        }
        report.line("```");
    }
    report
}

impl Report {
    fn line(&mut self, line: &str) {
        let _ = writeln!(self.blessed, "{line}");
    }
}

fn cell(name: &str, block: &[(usize, &str)], report: &mut Report) -> Declared {
    let mut declared = Declared::default();
    for (number, line) in block {
        if let Err(fault) = declared.line(line) {
            report.faults.push(format!("{name}:{number}: {fault}"));
        }
        report.line(line);
    }
    declared
}

/// Checks a cell that must be rejected with exactly these faults.
fn wrong(name: &str, block: &[(usize, &str)], report: &mut Report) {
    report.shown += 1;
    let (expected, lines): (Vec<_>, Vec<_>) = block.iter().partition(|(_, line)| is_seen(line));
    let declared = cell(name, &lines, report);
    let expected: Vec<String> = expected.iter().map(|(_, line)| plain(line)).collect();
    let found: Vec<String> = declared.faults().iter().map(|fault| format!("| {fault}")).collect();
    let number = block.first().map_or(0, |(number, _)| *number);
    compare(&format!("{name}:{number}: in this cell"), &expected, &found, report);
    found.iter().for_each(|line| report.line(line));
}

fn compare(place: &str, expected: &[String], found: &[String], report: &mut Report) {
    let list = |lines: &[String]| {
        if lines.is_empty() { "    nothing".into() } else { format!("    {}", lines.join("\n    ")) }
    };
    if found != expected {
        let (expected, found) = (list(expected), list(found));
        report.faults.push(format!("{place}\n  expected\n{expected}\n  but saw\n{found}"));
    }
}

fn transcript(name: &str, declared: &Declared, block: &[(usize, &str)], report: &mut Report) {
    report.shown += 1;
    let first = block.first().map_or(0, |(number, _)| *number);
    let mut drive = match Drive::new(declared) {
        Ok(drive) => drive,
        Err(fault) => return report.faults.push(format!("{name}:{first}: {fault}")),
    };
    let mut rest = block;
    while let [(number, line), after @ ..] = rest {
        rest = after;
        report.line(line);
        if line.trim().is_empty() || line.trim().starts_with('#') {
            continue;
        }
        if is_seen(line) {
            report.faults.push(format!("{name}:{number}: this stands below no line that makes it happen"));
            continue;
        }
        let length = after.iter().position(|(_, line)| !is_seen(line)).unwrap_or(after.len());
        let entry = Entry { number: *number, line, below: after[..length].to_vec() };
        rest = &after[length..];
        if let Err(fault) = carry_out(name, declared, &mut drive, &entry, report) {
            report.faults.push(format!("{name}:{number}: {fault}"));
            rest.iter().for_each(|(_, line)| report.line(line));
            return;
        }
    }
}

fn carry_out(
    name: &str,
    declared: &Declared,
    drive: &mut Drive,
    entry: &Entry<'_>,
    report: &mut Report,
) -> Result<(), String> {
    let begin = drive.now();
    let step = steps::read(entry.line, &declared.cell)?;
    let found = drive.step(&step)?;
    let found: Vec<String> = found.iter().map(|seen| words(seen, begin, drive.now())).collect();
    let expected: Vec<String> = entry.below.iter().map(|(_, line)| plain(line)).collect();
    compare(&format!("{name}:{}: after `{}`", entry.number, plain(entry.line)), &expected, &found, report);
    let indent = entry.line.len() - entry.line.trim_start().len() + 4;
    for text in &found {
        // A line that is still correct keeps the remark at its end.
        let kept = entry.below.iter().find(|(_, line)| plain(line) == *text);
        report.line(&kept.map_or_else(|| format!("{:indent$}{text}", ""), |(_, line)| (*line).into()));
    }
    Ok(())
}

/// An observed event as text. It starts with `+3` if the event came three ticks after the step began. An event in the
/// last tick of the step has no such prefix.
fn words(seen: &Seen, begin: u64, end: u64) -> String {
    if seen.at == end { seen.text.clone() } else { format!("+{} {}", seen.at - begin, seen.text) }
}

/// Whether a line of a transcript is an expected event.
fn is_seen(line: &str) -> bool {
    let mut words = line.split_whitespace().skip_while(|word| word.starts_with('+'));
    let first = words.next().unwrap_or("");
    let second = words.next().unwrap_or("");
    first == "|" || ["<-", "drops", "holds", "rejects", "=>"].contains(&second)
}

/// A line without its remark, and with single spaces between words.
fn plain(line: &str) -> String {
    let mut in_text = false;
    let mut plain = String::new();
    for c in line.trim().chars() {
        in_text ^= c == '"' && !plain.ends_with('\\');
        match c {
            '#' if !in_text => break,
            ' ' if !in_text && plain.ends_with(' ') => {}
            c => plain.push(c),
        }
    }
    plain.trim_end().into()
}
