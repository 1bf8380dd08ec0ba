//! What the check of a cell found, as a person reads it.

use super::cell::Subject;
use crate::args::{Times, VerifyVerb};
use crate::cell_file;
use crate::exit::Failure;
use crate::output::{BAD, FAINT, GOOD, HEAD, NOTE, Output, Styled, count, grouped};
use imrs_model::cell::{CellPlan, Coverage, Finding, Kind, Phase, Verdicts};
use imrs_protocol::TaskId;
use imrs_protocol::script::Address;
use std::fmt::Write as _;

/// How many lines of a chart are shown of every finding but the first.
const CHART_TAIL: usize = 8;

/// What there is to tell.
pub(super) struct Telling<'a> {
    pub subject: &'a Subject,
    pub plan: &'a CellPlan,
    pub verdicts: &'a Verdicts,
    pub args: &'a VerifyVerb,
    /// The number of the finding that was saved.
    pub saved: Option<usize>,
}

impl Telling<'_> {
    /// Shows the findings, the bounds and the verdict.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn show(&self, out: &mut Output) -> Result<(), Failure> {
        let (subject, verdicts) = (self.subject, self.verdicts);
        for (i, finding) in verdicts.findings.iter().enumerate() {
            let head = format!("{}: {}", finding.kind.name(), finding.cause);
            out.line(Styled(if finding.kind == Kind::Vacuous { NOTE } else { BAD }, head))?;
            if let Some((line, column, text)) = subject.place_of(finding) {
                out.line(format!("  --> {}:{line}:{column}  {text}", subject.file))?;
            }
            chart(finding, i == 0, out)?;
            if let Some(how) = self.step_by_step(i + 1, finding) {
                out.line(format!("  step by step: {how}"))?;
            }
            out.line("")?;
        }
        if let (Some(path), None, false) = (&self.args.faults.save, self.saved, verdicts.findings.is_empty())
        {
            let file = cell_file::shown(path);
            out.line(Styled(NOTE, format!("nothing was saved to {file}: no steps lead to this finding")))?;
        }
        for phase in &verdicts.phases {
            out.line(Styled(HEAD, bounds(self.plan, phase)))?;
            out.line(format!("  {}", looked_at(phase)))?;
        }
        out.line(Styled(FAINT, format!("  looked at: {}", self.times())))?;
        let untried = "only for faults that did not come about within these bounds, so not tried (more faults: --loss, --dup, --reorder, --crash, --drift)";
        self.statements(untried, &verdicts.not_exercised, out)?;
        let unseen = "not reached before the search ended, which says nothing about them";
        self.statements(unseen, &verdicts.not_seen, out)?;
        self.last_line(out)
    }

    /// Which times are looked at: what a verdict is about.
    fn times(&self) -> String {
        let msec = |usec: u64| match (usec / 1000, usec % 1000) {
            (whole, 0) => format!("{whole} msec"),
            _ => format!("{usec} usec"),
        };
        let tick = msec(self.subject.tick_us);
        let model = self.subject.model_tick_us.map(|usec| {
            format!("; times of actions, delays and timers rounded outward to a model tick of {}", msec(usec))
        });
        let model = model.unwrap_or_default();
        let ends = "at the ends: packets take their link's bound, actions their least or their most time";
        let between = self.verdicts.phases.iter().any(|phase| phase.between);
        let between = if between {
            "; between them: also until right after anything that happens meanwhile"
        } else {
            ""
        };
        format!("{ends}{between}; tick {tick}{model}")
    }

    /// The command that shows a finding step by step. None where there is no way to it.
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
                let counts = [
                    ("loss", faults.loss),
                    ("dup", faults.dup),
                    ("reorder", faults.reorder),
                    ("drift", faults.drift),
                ];
                for (flag, count) in counts.into_iter().filter(|(_, count)| *count > 0) {
                    let _ = write!(command, " --{flag} {count}");
                }
                if let Some(times) = clap::ValueEnum::to_possible_value(&faults.times)
                    && faults.times != Times::default()
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

    /// Lines of statements, by task: `armL 12, 14; hoist 31`.
    fn statements(&self, what: &str, which: &[(TaskId, Address)], out: &mut Output) -> Result<(), Failure> {
        let subject = self.subject;
        let lines = which.iter().filter_map(|&(task, at)| Some((task, subject.place(task, at)?.0)));
        let mut lines: Vec<(TaskId, usize)> = lines.collect();
        lines.dedup();
        if lines.is_empty() {
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

    fn last_line(&self, out: &mut Output) -> Result<(), Failure> {
        let file = &self.subject.file;
        let checks = match self.plan.checks.len() {
            0 => String::new(),
            1 => "; the check holds".to_owned(),
            n => format!("; all {n} checks hold"),
        };
        match (self.verdicts.findings.len(), self.verdicts.is_complete()) {
            (0, true) => {
                let text =
                    format!("{file}: nothing found, everything within these bounds was looked at{checks}");
                out.line(Styled(GOOD, text))
            }
            (0, false) => {
                let text =
                    format!("{file}: nothing found so far; the search was cut short: it proves nothing yet");
                out.line(Styled(NOTE, text))
            }
            (n, _) => out.line(Styled(BAD, format!("{file}: {}", count(n as u64, "finding")))),
        }
    }
}

/// A word of a command, as a shell takes it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

fn chart(finding: &Finding, whole: bool, out: &mut Output) -> Result<(), Failure> {
    let lines: Vec<&str> = finding.chart.lines().collect();
    let skipped = if whole { 0 } else { lines.len().saturating_sub(CHART_TAIL + 1) };
    for (i, line) in lines.iter().enumerate() {
        if i == 0 || i > skipped {
            out.line(format!("  {line}"))?;
        } else if i == skipped {
            out.line(Styled(FAINT, format!("     ... {skipped} lines more")))?;
        }
    }
    Ok(())
}

/// What may go wrong in a phase, declared and asked for together.
pub(super) fn bounds(plan: &CellPlan, phase: &Coverage) -> String {
    let faults = match phase.phase {
        Phase::FaultFree | Phase::Between => "Without faults".into(),
        Phase::Faults => format!("With at most {}", faults(plan, phase.hypothesis)),
    };
    let times = if phase.between { "times at their ends and between" } else { "times at their ends" };
    format!("{faults}, {times}")
}

fn faults(plan: &CellPlan, hypothesis: usize) -> String {
    let (cell, Some(faults)) = (plan.table.cell(), plan.faults.get(hypothesis)) else { return String::new() };
    let node = |at: usize| cell.nodes.get(at).map_or("?", |node| node.name.as_str());
    let counted = [
        (faults.loss, "packet lost", "packets lost"),
        (faults.dup, "packet doubled", "packets doubled"),
        (faults.reorder, "packet overtaking another", "packets overtaking others"),
        (faults.fail, "action failing", "actions failing"),
        (faults.drift, "tick missed or counted twice", "ticks missed or counted twice"),
    ];
    let mut parts: Vec<String> = Vec::new();
    for (count, one, more) in counted.into_iter().filter(|(count, ..)| *count > 0) {
        parts.push(format!("{count} {}", if count == 1 { one } else { more }));
    }
    parts.extend(faults.crash.iter().map(|at| format!("a crash of {}", node(at.index()))));
    for link in faults.cut.iter().filter_map(|&at| cell.links.get(at)) {
        parts.push(format!("the link {} -- {} cut once", node(link.a.index()), node(link.b.index())));
    }
    parts.join(", ")
}

fn looked_at(phase: &Coverage) -> String {
    let cut = phase.ended_by.as_ref().map(|by| format!("; cut short: {by}"));
    format!(
        "{} states, {} steps, {:.1} s{}",
        grouped(phase.states),
        grouped(phase.moves),
        phase.seconds,
        cut.unwrap_or_else(|| {
            let whole = if phase.pruned {
                "; everything up to the findings"
            } else {
                "; everything within the bounds"
            };
            whole.into()
        })
    )
}
