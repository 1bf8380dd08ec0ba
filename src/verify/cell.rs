//! `imrs verify CELL`: the cell's own scripts and communication tasks under the checker, with the faults that it declares.

use super::DEFAULT_MEMORY;
use crate::args::{CellFaultArgs, Format, VerifyVerb};
use crate::cell_file::{self, CellFileError};
use crate::exit::{Exit, Failure, did_you_mean};
use crate::output::{BAD, FAINT, GOOD, HEAD, NOTE, Output, Styled, count, grouped};
use imrs_language::hir::Faults;
use imrs_language::lower::{Behaviour, Check, CheckKind, Lowered};
use imrs_language::{Source, Unit, compile, render};
use imrs_model::cell::{
    Budget, CellCheck, CellFaults, CellPlan, Conduct, Coverage, Finding, Holds, Kind, Phase, Verdicts,
    check_cell, svg,
};
use imrs_protocol::script::Address;
use imrs_protocol::{CellTable, NodeId, TaskId};
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;

/// How many lines of a chart are shown of every finding but the first.
const CHART_TAIL: usize = 8;

/// A cell, what it was compiled from and to.
struct Subject {
    file: String,
    source: Source,
    lowered: Lowered,
    table: Arc<CellTable>,
}

/// Checks a cell.
///
/// # Errors
/// [`Failure`].
pub fn run(path: &Path, args: &VerifyVerb, out: &mut Output) -> Result<Exit, Failure> {
    let (file, source) = (cell_file::shown(path), cell_file::read(path)?);
    let compiled = compile(&source);
    let Some(lowered) = compiled.lower(Unit::Ticks) else {
        out.text(&render::text(&compiled.diagnostics, &file, Some(&source), render::Style::Coloured))?;
        return Ok(Exit::Finding);
    };
    let table = CellTable::new(lowered.cell.clone()).map(Arc::new).map_err(|errors| {
        let all: Vec<String> = errors.iter().map(ToString::to_string).collect();
        Failure::Usage(format!("{file}: in whole ticks the cell does not fit: {}", all.join("; ")))
    })?;
    let subject = Subject { file, source, lowered, table };
    let verdicts = check_cell(&Arc::new(subject.plan(args)?));
    if let (Some(path), Some(finding)) = (&args.faults.trace, verdicts.findings.first()) {
        let names: Vec<String> = subject.table.cell().tasks.iter().map(|task| task.name.clone()).collect();
        std::fs::write(path, svg(&names, &finding.steps, &finding.cause))
            .map_err(|source| CellFileError::Unwritable { path: path.clone(), source })?;
    }
    match args.verify.format.unwrap_or_default() {
        Format::Json => out.json(&subject.answer(&verdicts))?,
        Format::Text => subject.show(&verdicts, out)?,
    }
    Ok(match (verdicts.findings.is_empty(), verdicts.is_complete()) {
        (false, _) => Exit::Finding,
        (true, true) => Exit::Well,
        (true, false) => Exit::Budget,
    })
}

impl Subject {
    fn plan(&self, args: &VerifyVerb) -> Result<CellPlan, Failure> {
        let tasks = self.lowered.tasks.iter().map(conduct).collect();
        let mut plan = CellPlan::new(Arc::clone(&self.table), tasks);
        plan.faults = self.faults(&self.lowered.faults, &args.faults)?;
        plan.checks = self.lowered.checks.iter().map(check).collect();
        let seconds = args.faults.within.as_secs_f64();
        plan.budget = Budget { seconds, bytes: args.verify.memory.unwrap_or(DEFAULT_MEMORY), ..plan.budget };
        plan.jobs = args.verify.jobs.map_or(2, usize::from);
        Ok(plan)
    }

    fn faults(&self, declared: &Faults, more: &CellFaultArgs) -> Result<CellFaults, Failure> {
        let mut crash = declared.crash.clone();
        for name in &more.crash {
            crash.push(self.node(name)?);
        }
        Ok(CellFaults {
            loss: declared.loss.saturating_add(more.loss),
            dup: declared.dup.saturating_add(more.dup),
            fail: declared.fail,
            drift: declared.drift.saturating_add(more.drift),
            crash,
            cut: declared.cut.clone(),
        })
    }

    /// The node of this name, or that of the task of this name.
    fn node(&self, name: &str) -> Result<NodeId, Failure> {
        let cell = self.table.cell();
        let node = cell.nodes.iter().position(|node| node.name == name).map(NodeId::from_index);
        let of_task = || cell.tasks.iter().find(|task| task.name == name).map(|task| task.node);
        node.or_else(of_task).ok_or_else(|| {
            let nodes = cell.nodes.iter().map(|node| node.name.as_str());
            let names = nodes.chain(cell.tasks.iter().map(|task| task.name.as_str()));
            Failure::Usage(format!("no node and no task `{name}`{}", did_you_mean(name, names)))
        })
    }

    fn task(&self, task: TaskId) -> &str {
        self.table.cell().tasks.get(task.index()).map_or("?", |task| task.name.as_str())
    }

    /// Line and column, from 1, and the first line of the statement that an operation belongs to.
    fn place(&self, task: TaskId, at: Address) -> Option<(usize, usize, &str)> {
        let Behaviour::Script(script) = self.lowered.tasks.get(task.index())? else { return None };
        let span = *script.spans.get(usize::from(at))?;
        let (line, column) = self.source.position(span.start);
        Some((line, column, self.source.slice(span).lines().next().unwrap_or_default()))
    }

    fn place_of(&self, finding: &Finding) -> Option<(usize, usize, &str)> {
        let of_check = || {
            let check = self.lowered.checks.get(finding.check?)?;
            let (line, column) = self.source.position(check.span.start);
            Some((line, column, self.source.slice(check.span)))
        };
        let of_task = finding.task.zip(finding.address).and_then(|(task, at)| self.place(task, at));
        of_task.or_else(of_check)
    }

    fn show(&self, verdicts: &Verdicts, out: &mut Output) -> Result<(), Failure> {
        for (i, finding) in verdicts.findings.iter().enumerate() {
            let head = format!("{}: {}", finding.kind.name(), finding.cause);
            out.line(Styled(if finding.kind == Kind::Vacuous { NOTE } else { BAD }, head))?;
            if let Some((line, column, text)) = self.place_of(finding) {
                out.line(format!("  --> {}:{line}:{column}  {text}", self.file))?;
            }
            self.chart(finding, i == 0, out)?;
            out.line("")?;
        }
        for phase in &verdicts.phases {
            out.line(Styled(HEAD, self.bounds(phase)))?;
            out.line(format!("  {}", looked_at(phase)))?;
        }
        self.statements("not called for by these faults", &verdicts.not_exercised, out)?;
        self.statements("not reached before the search ended", &verdicts.not_seen, out)?;
        self.last_line(verdicts, out)
    }

    fn chart(&self, finding: &Finding, whole: bool, out: &mut Output) -> Result<(), Failure> {
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

    fn bounds(&self, phase: &Coverage) -> String {
        let faults = &self.lowered.faults;
        match phase.phase {
            Phase::FaultFree => "Without faults".into(),
            Phase::Faults => {
                let names = faults.crash.iter().filter_map(|node| self.table.cell().nodes.get(node.index()));
                let crash: String = names.map(|node| format!(", crash of {}", node.name)).collect();
                let cut =
                    if faults.cut.is_empty() { String::new() } else { format!(", {} cut", faults.cut.len()) };
                format!(
                    "With the declared faults ({} lost, {} doubled{crash}{cut}) and those asked for",
                    faults.loss, faults.dup
                )
            }
        }
    }

    fn statements(&self, what: &str, which: &[(TaskId, Address)], out: &mut Output) -> Result<(), Failure> {
        let lines = which.iter().filter_map(|&(task, at)| Some((self.task(task), self.place(task, at)?.0)));
        let mut lines: Vec<String> = lines.map(|(task, line)| format!("{task} line {line}")).collect();
        lines.dedup();
        if lines.is_empty() {
            return Ok(());
        }
        out.line(Styled(FAINT, format!("  {}: {}", what, lines.join(", "))))
    }

    fn last_line(&self, verdicts: &Verdicts, out: &mut Output) -> Result<(), Failure> {
        let (file, checks) = (&self.file, count(self.lowered.checks.len() as u64, "check"));
        match (verdicts.findings.len(), verdicts.is_complete()) {
            (0, true) => {
                let text = format!(
                    "{file}: nothing found, everything within these bounds was looked at; {checks} hold"
                );
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

    fn answer<'a>(&'a self, verdicts: &'a Verdicts) -> Answer<'a> {
        let told = |finding: &'a Finding| {
            let place = self.place_of(finding);
            Told {
                kind: finding.kind.name(),
                with_faults: finding.phase == Phase::Faults,
                task: finding.task.map(|task| self.task(task)),
                line: place.map(|(line, ..)| line),
                column: place.map(|(_, column, _)| column),
                cause: &finding.cause,
                at_ticks: finding.at_ticks,
                chart: &finding.chart,
            }
        };
        let settled = |(i, check): (usize, &'a Check)| {
            let fails = verdicts.findings.iter().any(|f| f.kind == Kind::Check && f.check == Some(i));
            let outcome = match (fails, verdicts.is_complete()) {
                (true, _) => "fails",
                (false, true) => "holds",
                (false, false) => "unknown",
            };
            Settled { name: &check.name, expect: "holds", outcome, as_expected: outcome == "holds" }
        };
        Answer {
            version: 1,
            cell: &self.lowered.cell.name,
            file: &self.file,
            complete: verdicts.is_complete(),
            claims: self.lowered.checks.iter().enumerate().map(settled).collect(),
            findings: verdicts.findings.iter().map(told).collect(),
            phases: &verdicts.phases,
        }
    }
}

/// The answer for programs.
#[derive(Serialize)]
struct Answer<'a> {
    version: u32,
    cell: &'a str,
    file: &'a str,
    complete: bool,
    /// The checks of the file.
    claims: Vec<Settled<'a>>,
    findings: Vec<Told<'a>>,
    phases: &'a [Coverage],
}

#[derive(Serialize)]
struct Settled<'a> {
    name: &'a str,
    expect: &'static str,
    outcome: &'static str,
    as_expected: bool,
}

#[derive(Serialize)]
struct Told<'a> {
    kind: &'static str,
    with_faults: bool,
    task: Option<&'a str>,
    line: Option<usize>,
    column: Option<usize>,
    cause: &'a str,
    at_ticks: u64,
    chart: &'a str,
}

/// What a task does in the model.
pub fn conduct(behaviour: &Behaviour) -> Conduct {
    match behaviour {
        Behaviour::Script(script) => {
            let values =
                |values: &[i64]| values.iter().filter_map(|&value| i32::try_from(value).ok()).collect();
            Conduct::Program {
                program: Arc::clone(&script.program),
                values: script.actions.iter().map(|action| values(&action.values)).collect(),
            }
        }
        Behaviour::Extern(rate) => Conduct::Extern(*rate),
    }
}

fn check(check: &Check) -> CellCheck {
    let holds = match &check.kind {
        CheckKind::Always(terms) => Holds::Always(terms.clone()),
        CheckKind::Leads { when, then, within } => {
            Holds::Leads { when: when.clone(), then: then.clone(), within: *within }
        }
    };
    CellCheck { name: check.name.clone(), holds }
}

fn looked_at(phase: &Coverage) -> String {
    let cut = phase.ended_by.as_ref().map(|by| format!("; cut short: {by}"));
    format!(
        "{} states, {} steps, {:.1} s{}",
        grouped(phase.states),
        grouped(phase.moves),
        phase.seconds,
        cut.unwrap_or_else(|| "; everything within the bounds".into())
    )
}
