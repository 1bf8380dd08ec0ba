//! Prints the result of checking a cell, for people.

use super::advice::help;
use super::covered;
use super::limits::{not_looked_for, values_tried};
use super::subject::Subject;
use crate::args::{self, CellFaultArgs, VerifyVerb};
use crate::cell_file;
use crate::failure::Failure;
use crate::kept::nothing_kept;
use crate::output::{BAD, FAINT, GOOD, NOTE, Output, Styled, count};
use imrs_model::cell::{CellPlan, Concerned, Finding, Kind, Times, Verdicts};
use imrs_protocol::TaskId;
use imrs_protocol::script::Address;
use std::fmt::Write as _;

/// How many lines are shown from the end of a chart, for every finding but the first.
const CHART_TAIL: usize = 8;
/// At most this many statements are shown with their text.
const FEW: usize = 6;
/// The greatest number of columns for a statement's text.
const EXCERPT: usize = 48;

/// The result of checking a cell, with the data that its texts need.
pub(super) struct Telling<'a> {
    pub subject: &'a Subject,
    pub plan: &'a CellPlan,
    pub verdicts: &'a Verdicts,
    pub args: &'a VerifyVerb,
    /// The number of the finding that was saved.
    pub saved: Option<usize>,
    /// Whether a finding could not be drawn or saved.
    pub failed: bool,
}

/// For each file that the user named and that was not written although nothing failed, a message.
pub(super) fn unkept(args: &CellFaultArgs, verdicts: &Verdicts, saved: Option<usize>) -> Vec<String> {
    let none = verdicts.findings.is_empty();
    let why = match (none, &verdicts.refused) {
        (true, Some(_)) => "the cell was not checked",
        (true, None) => "nothing was found",
        (false, _) => "no steps lead to this finding",
    };
    let drawing = args.trace.as_ref().filter(|_| none);
    let recording = args.save.as_ref().filter(|_| saved.is_none());
    [drawing, recording].into_iter().flatten().map(|path| nothing_kept(path, why)).collect()
}

impl Telling<'_> {
    /// Shows the findings, the bounds and the verdict.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn show(&self, out: &mut Output) -> Result<(), Failure> {
        let (subject, verdicts) = (self.subject, self.verdicts);
        let unkept = if self.failed { vec![] } else { unkept(&self.args.faults, verdicts, self.saved) };
        if let Some(refused) = &verdicts.refused {
            unkept.into_iter().try_for_each(|said| out.line(Styled(NOTE, said)))?;
            out.line(Styled(NOTE, format!("not checked: {}", refused.why)))?;
            if let Some((line, column, text)) = subject.place(refused.task, refused.at) {
                out.line(format!("  --> {}:{line}:{column}  {text}", subject.file))?;
            }
            return out.line(Styled(NOTE, format!("{}: not checked: it proves nothing", subject.file)));
        }
        for (number, finding) in (1..).zip(&verdicts.findings) {
            let whole = number == self.args.faults.finding.map_or(1, usize::from);
            let all = format!("--finding {number}");
            subject.tell(finding, (!whole).then_some(&all), out)?;
            if let Some(how) = self.step_by_step(number, finding) {
                out.line(format!("  step by step: {how}"))?;
            }
            out.line("")?;
        }
        for warning in &verdicts.warnings {
            subject.tell(warning, None, out)?;
            out.line("")?;
        }
        unkept.into_iter().try_for_each(|said| out.line(Styled(NOTE, said)))?;
        verdicts.phases.iter().try_for_each(|phase| covered::show(subject, self.plan, phase, out))?;
        out.line(Styled(FAINT, format!("  looked at: {}", self.times())))?;
        for what in not_looked_for(self.plan) {
            out.line(Styled(FAINT, format!("  not looked for: {what}")))?;
        }
        let untried = "never reached at these bounds: no fault, time_out or timer of theirs leads there (more faults: --loss, --dup, --reorder, --crash, --pause, --drift)";
        subject.statements(untried, &verdicts.not_exercised, out)?;
        values_tried(&verdicts.outside, out)?;
        let open = match (self.plan.has_extern(), self.plan.has_open_results()) {
            (true, false) => "extern tasks may send other values, and at other times",
            (false, _) => "actions may give other results",
            (true, true) => {
                "actions may give other results, and extern tasks may send other values, and at other times"
            }
        };
        let untold = format!("not reached with what was tried: {open}");
        subject.statements(&untold, &verdicts.not_tried, out)?;
        let unseen = if verdicts.is_complete() {
            "not reached on the paths up to the findings, which proves nothing about them"
        } else {
            "not reached before the search ended, which proves nothing about them"
        };
        subject.statements(unseen, &verdicts.not_seen, out)?;
        for (check, what) in &verdicts.still {
            let name = self.plan.checks.get(*check).map_or("?", |check| check.name.as_str());
            out.line(Styled(NOTE, format!("  check `{name}`: {what} in every state that was looked at")))?;
        }
        subject.tell_rounded(!verdicts.findings.is_empty(), out)?;
        self.last_line(out)
    }

    /// The times at which events were tried: the scope of a verdict.
    fn times(&self) -> String {
        let msec = |usec: u64| {
            if usec.is_multiple_of(1000) { format!("{} msec", usec / 1000) } else { format!("{usec} usec") }
        };
        let tick = msec(self.subject.tick_us);
        let model = self
            .subject
            .model_tick_us
            .filter(|_| self.plan.step > 1)
            .map(|usec| format!("; of the times between the ends every {} is looked at", msec(usec)));
        let mut used: Vec<Times> = self.verdicts.phases.iter().map(|phase| phase.times).collect();
        used.sort_unstable_by(|a, b| b.cmp(a));
        used.dedup();
        let words = used.iter().map(|times| match times {
            Times::Every if self.plan.step > 1 => "every model tick: any of them within a packet's bound and an action's times",
            Times::Zones => "every tick, by zones: any of them within a packet's bound and an action's times; a standstill is reported only if all times of a zone (a set of times) lead to it",
            Times::Every => "every tick: any of them within a packet's bound and an action's times",
            Times::Between => "the ends and after events: the bound of a packet, the least and the most time of an action, and right after anything else that happens",
            Times::Ends | Times::Auto => "the ends: the bound of a packet, the least and the most time of an action",
        });
        format!("{}; tick {tick}{}", words.collect::<Vec<_>>().join("; "), model.unwrap_or_default())
    }

    /// The command that shows a finding step by step; `None` if the finding has no counterexample.
    fn step_by_step(&self, number: usize, finding: &Finding) -> Option<String> {
        if finding.moves.is_empty() {
            return None;
        }
        let show = |file: &str| format!("imrs monitor --replay {file}");
        match &self.args.faults.save {
            Some(file) if self.saved == Some(number) => Some(show(&quoted(&cell_file::shown(file)))),
            Some(_) | None => {
                let mut command = format!("imrs verify {}", quoted(&self.subject.file));
                let faults = &self.args.faults;
                if faults.paper {
                    command.push_str(" --paper");
                }
                let counts = [
                    ("loss", faults.loss),
                    ("dup", faults.dup),
                    ("reorder", faults.reorder),
                    ("drift", faults.drift),
                    ("pause", faults.pause),
                ];
                for (flag, count) in counts.into_iter().filter(|(_, count)| *count > 0) {
                    let _ = write!(command, " --{flag} {count}");
                }
                if let Some(times) = clap::ValueEnum::to_possible_value(&faults.times)
                    && faults.times != args::Times::default()
                {
                    let _ = write!(command, " --times {}", times.get_name());
                }
                for name in &faults.crash {
                    let _ = write!(command, " --crash {}", quoted(name));
                }
                if number > 1 {
                    let _ = write!(command, " --finding {number}");
                }
                Some(format!("{command} --save FILE; {}", show("FILE")))
            }
        }
    }

    fn last_line(&self, out: &mut Output) -> Result<(), Failure> {
        let file = &self.subject.file;
        let checks = match self.plan.checks.len() {
            0 => String::new(),
            1 => "; the check holds".to_owned(),
            n => format!("; all {n} checks hold"),
        };
        match (self.verdicts.findings.len(), self.verdicts.is_complete()) {
            (0, true) => {
                let whole = self.verdicts.phases.iter().all(|phase| phase.times >= Times::Every);
                let (found, style) = match self.verdicts.warnings.len() {
                    0 => ("nothing found".to_owned(), GOOD),
                    n => (format!("no finding, {}", count(n as u64, "warning")), NOTE),
                };
                let what =
                    if whole { "within these bounds" } else { "within these bounds and at these times" };
                out.line(Styled(style, format!("{file}: {found}, everything {what} was looked at{checks}")))
            }
            (0, false) => {
                let text = format!(
                    "{file}: nothing found so far; the search was cut short: it proves nothing yet (--within and --memory give it more)"
                );
                out.line(Styled(NOTE, text))
            }
            (n, _) => out.line(Styled(BAD, format!("{file}: {}", count(n as u64, "finding")))),
        }
    }
}

impl Subject {
    /// Prints a finding: what is wrong and where, the other tasks, the counterexample, and the usual remedy. `all` is the
    /// command that shows the whole chart; if it is given, only the end of the chart is printed.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn tell(&self, finding: &Finding, all: Option<&String>, out: &mut Output) -> Result<(), Failure> {
        let (style, warning) = match finding.kind {
            kind if kind.is_warning() => (NOTE, "warning: "),
            Kind::Vacuous => (NOTE, ""),
            _ => (BAD, ""),
        };
        out.line(Styled(style, format!("{warning}{}: {}", finding.kind.name(), finding.cause)))?;
        let (line, column, text) = self.place_of(finding);
        out.line(format!("  --> {}:{line}:{column}  {text}", self.file))?;
        if !finding.also.is_empty() {
            out.line(format!("  also {}", self.also(finding)))?;
        }
        for other in &finding.others {
            out.line(format!("  meanwhile {}", self.meanwhile(other)))?;
        }
        chart(&finding.chart, all, out)?;
        self.happens(finding).into_iter().try_for_each(|happens| out.line(format!("  {happens}")))?;
        out.line(format!("  help: {}", help(finding.kind)))
    }

    /// Prints the times that are not multiples of the tick. If there are findings (`found`), the rounding may have caused them.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn tell_rounded(&self, found: bool, out: &mut Output) -> Result<(), Failure> {
        let all: Vec<_> = self.rounded().collect();
        for &(line, column, what) in all.iter().take(FEW) {
            let file = &self.file;
            out.line(Styled(NOTE, format!("  note[N101]: {file}:{line}:{column}: {what}")))?;
        }
        if let Some(more) = all.len().checked_sub(FEW).filter(|&more| more > 0) {
            out.line(format!("  and {} more", count(more as u64, "rounded time")))?;
        }
        if !all.is_empty() && found {
            let text = "  not confirmed: these findings may come from the rounding; write whole ticks, or a finer `tick`";
            out.line(Styled(NOTE, text.to_owned()))?;
        }
        Ok(())
    }

    /// The other tasks with the same finding, as text: `b (line 39), c (line 50), which have the same statements`.
    fn also(&self, finding: &Finding) -> String {
        let place = |&task: &TaskId| {
            let line = finding.address.and_then(|at| self.place(task, at)).map(|place| place.0);
            let line = line.map_or_else(String::new, |line| format!(" (line {line})"));
            format!("{}{line}", self.task(task))
        };
        let tasks: Vec<String> = finding.also.iter().map(place).collect();
        let have = if tasks.len() == 1 { "has" } else { "have" };
        format!("{}, which {have} the same statements", tasks.join(", "))
    }

    /// The state of another task at the finding, as text: `camera is at line 22: run look`.
    fn meanwhile(&self, other: &Concerned) -> String {
        let name = self.task(other.task);
        let place = other.at.and_then(|at| self.place(other.task, at));
        let Some((line, _, text)) = place else { return format!("{name} {}", other.does) };
        if text == name {
            return format!("{name} only answers messages (line {line})");
        }
        if other.does.starts_with("has ") || other.does.starts_with("is ") {
            return format!("{name} {} (last at line {line}: {})", other.does, short(text));
        }
        format!("{name} is at line {line}: {}", short(text))
    }

    /// Prints statements by task: `armL line 12, 14; hoist line 31`. If there are only a few, it prints them with their text.
    pub fn statements(
        &self,
        what: &str,
        which: &[(TaskId, Address)],
        out: &mut Output,
    ) -> Result<(), Failure> {
        let subject = self;
        let places: Vec<_> =
            which.iter().filter_map(|&(task, at)| Some((task, subject.place(task, at)?))).collect();
        let mut lines: Vec<(TaskId, usize)> = places.iter().map(|&(task, (line, ..))| (task, line)).collect();
        lines.dedup();
        if lines.is_empty() {
            return Ok(());
        }
        if places.len() <= FEW {
            out.line(Styled(FAINT, format!("  statements {what}:")))?;
            for (task, (line, column, text)) in places {
                let text = format!("    {} {line}:{column}  {}", subject.task(task), short(text));
                out.line(Styled(FAINT, text))?;
            }
            return Ok(());
        }
        let of_task = |same: &[(TaskId, usize)]| {
            let numbers: Vec<String> = same.iter().map(|(_, line)| line.to_string()).collect();
            let task = same.first().map_or("?", |&(task, _)| subject.task(task));
            format!("{task} line {}", numbers.join(", "))
        };
        let tasks: Vec<String> = lines.chunk_by(|a, b| a.0 == b.0).map(of_task).collect();
        out.line(Styled(FAINT, format!("  statements {what}: {}", tasks.join("; "))))
    }
}

/// A word of a command, quoted for a shell.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// The beginning of a text, if it is long.
fn short(text: &str) -> String {
    if text.chars().count() <= EXCERPT {
        return text.to_owned();
    }
    let kept: String = text.chars().take(EXCERPT - 3).collect();
    format!("{}...", kept.trim_end())
}

/// Prints a chart. If `all` is given, it names the command that shows the whole chart, and only the end is printed.
///
/// # Errors
/// [`Failure::Output`].
pub fn chart(chart: &str, all: Option<&String>, out: &mut Output) -> Result<(), Failure> {
    let lines: Vec<&str> = chart.lines().collect();
    let skipped = all.map_or(0, |_| lines.len().saturating_sub(CHART_TAIL + 1));
    for (i, line) in lines.iter().enumerate() {
        if i == 0 || i > skipped {
            out.line(format!("  {line}"))?;
        } else if i == skipped {
            let more = count(skipped as u64, "line");
            let all = all.map_or("", String::as_str);
            out.line(Styled(FAINT, format!("     ... {more} before: {all} shows all")))?;
        }
    }
    Ok(())
}
