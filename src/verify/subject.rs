//! A cell that is checked, with its source text, and the plan of its check.

use super::DEFAULT_MEMORY;
use crate::args::{self, CellFaultArgs, Format, VerifyVerb};
use crate::cell_file;
use crate::check;
use crate::exit::{Exit, turned_down};
use crate::failure::Failure;
use crate::names::did_you_mean;
use crate::output::Output;
use imrs_language::hir::{self, CoupleKind, Faults};
use imrs_language::lower::{Action, Behaviour, Check, CheckKind, Lowered};
use imrs_language::{Options, Source, Span, Unit, compile_with, render};
use imrs_model::cell::{
    Budget, CellCheck, CellFaults, CellPlan, Conduct, Finding, Holds, Legend, Pause, Times,
};
use imrs_protocol::script::Address;
use imrs_protocol::{CellTable, NodeId, TaskId, Ticks};
use std::path::Path;
use std::sync::Arc;

/// A compiled cell, with its source text.
pub struct Subject {
    pub file: String,
    pub source: Source,
    pub lowered: Lowered,
    /// The place of each task's heading in the source text.
    tasks: Vec<Span>,
    /// The place of each work couple in the source text, in the order of the table.
    couples: Vec<Span>,
    pub table: Arc<CellTable>,
    /// The length of a tick in microseconds.
    pub tick_us: u64,
    /// The interval of the times at which an action may end, between its least and its most time, in microseconds;
    /// `None` if the cell declares none.
    pub model_tick_us: Option<u64>,
}

impl Subject {
    /// Compiles a cell file. The inner error says that the compiler rejected the cell; its diagnostics have then been
    /// printed.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn open(
        path: &Path,
        paper: bool,
        format: Format,
        out: &mut Output,
    ) -> Result<Result<Self, Exit>, Failure> {
        let (file, source) = (cell_file::shown(path), cell_file::read(path)?);
        let compiled = compile_with(&source, Options { paper });
        let Some(lowered) = compiled.lower(Unit::Ticks) else {
            let found = &compiled.diagnostics;
            match format {
                Format::Json => check::json(&file, &source, &compiled, out)?,
                Format::Text => {
                    out.text(&render::text(found, &file, Some(&source), render::Style::Coloured))?;
                }
            }
            return Ok(Err(turned_down(found)));
        };
        let table = CellTable::new(lowered.cell.clone()).map(Arc::new).map_err(|errors| {
            let all: Vec<String> = errors.iter().map(ToString::to_string).collect();
            Failure::Usage(format!("{file}: in whole ticks the cell does not fit: {}", all.join("; ")))
        })?;
        let tick_us = compiled.hir.as_ref().map_or(1, |hir| Unit::Ticks.usec(hir));
        let model_tick_us = compiled.hir.as_ref().and_then(|hir| hir.model_tick).map(|tick| tick.usec);
        let couples = compiled.hir.iter().flat_map(|hir| &hir.couples);
        let couples = couples.filter(|couple| matches!(couple.kind, CoupleKind::Work { .. }));
        let couples = couples.map(|couple| couple.span).collect();
        let tasks = compiled.hir.iter().flat_map(|hir| &hir.tasks).map(|task| task.span).collect();
        Ok(Ok(Self { file, source, lowered, tasks, couples, table, tick_us, model_tick_us }))
    }

    /// The plan with the faults that the cell declares.
    pub fn declared(&self, jobs: Option<u16>) -> CellPlan {
        let tasks = self.lowered.tasks.iter().map(conduct).collect();
        let mut plan = CellPlan::new(Arc::clone(&self.table), tasks);
        plan.faults =
            self.lowered.faults.iter().map(|declared| faults(declared, &self.table, self.tick_us)).collect();
        plan.checks = self.lowered.checks.iter().map(check).collect();
        let step = self.model_tick_us.unwrap_or(self.tick_us) / self.tick_us.max(1);
        plan.step = u32::try_from(step).unwrap_or(u32::MAX).max(1);
        plan.jobs = jobs.map_or(2, usize::from);
        plan.legend = self.legend();
        plan
    }

    /// The plan with the requested faults, budget and times added.
    ///
    /// # Errors
    /// An error if the faults name nodes or tasks that the cell does not have.
    pub fn plan(&self, args: &VerifyVerb) -> Result<CellPlan, Failure> {
        let mut plan = self.declared(args.verify.jobs);
        self.add(&args.faults, &mut plan.faults)?;
        let seconds = args.faults.within.as_secs_f64();
        plan.budget = Budget { seconds, bytes: args.verify.memory.unwrap_or(DEFAULT_MEMORY), ..plan.budget };
        plan.times = match args.faults.times {
            args::Times::Auto => Times::Auto,
            args::Times::Ends => Times::Ends,
            args::Times::Between => Times::Between,
            args::Times::Every => Times::Every,
            args::Times::Zones => Times::Zones,
        };
        // Without pauses and drift, `Auto` covers every tick.
        if plan.times == Times::Auto && !plan.faults.iter().any(CellFaults::disturb_time) {
            plan.step = 1;
        }
        Ok(plan)
    }

    /// The lines and the message formats that charts use.
    fn legend(&self) -> Legend {
        let line = |span: &Span| u32::try_from(self.source.position(span.start).0).unwrap_or(u32::MAX);
        let of_task = |behaviour: &Behaviour| match behaviour {
            Behaviour::Script(script) => {
                (script.spans.iter().map(line).collect(), script.handlers.iter().map(line).collect())
            }
            Behaviour::Extern(_) => (Vec::new(), Vec::new()),
        };
        let (lines, handlers) = self.lowered.tasks.iter().map(of_task).unzip();
        let formats = self.lowered.formats.iter();
        let formats = formats.map(|port| (port.message.clone(), port.answer.clone())).collect();
        Legend { lines, handlers, formats }
    }

    /// Adds the requested faults to each declared hypothesis.
    fn add(&self, more: &CellFaultArgs, all: &mut Vec<CellFaults>) -> Result<(), Failure> {
        let crash = more.crash.iter().map(|name| self.node(name)).collect::<Result<Vec<_>, _>>()?;
        if all.is_empty() {
            all.push(CellFaults::default());
        }
        for faults in all {
            faults.loss = faults.loss.saturating_add(more.loss);
            faults.dup = faults.dup.saturating_add(more.dup);
            faults.drift = faults.drift.saturating_add(more.drift);
            faults.reorder = more.reorder;
            faults.crash.extend(&crash);
            let pause = Pause::new(&self.table, None, None);
            faults.pause.extend(std::iter::repeat_n(pause, more.pause.into()));
        }
        Ok(())
    }

    /// The times that were rounded to the tick: for each, its line and column, and a text about the result.
    pub fn rounded(&self) -> impl Iterator<Item = (usize, usize, &str)> {
        self.lowered.notes.iter().map(|note| {
            let (line, column) = self.source.position(note.primary.span.start);
            (line, column, note.message.as_str())
        })
    }

    /// The node of this name, or the node of the task of this name.
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

    pub fn task(&self, task: TaskId) -> &str {
        self.table.cell().tasks.get(task.index()).map_or("?", |task| task.name.as_str())
    }

    /// The place of the statement to which an operation belongs: line and column, from 1, and the statement's first line.
    pub fn place(&self, task: TaskId, at: Address) -> Option<(usize, usize, &str)> {
        let Behaviour::Script(script) = self.lowered.tasks.get(task.index())? else { return None };
        let span = *script.spans.get(usize::from(at))?;
        let (line, column) = self.source.position(span.start);
        Some((line, column, self.source.slice(span).lines().next().unwrap_or_default()))
    }

    pub fn place_of(&self, finding: &Finding) -> (usize, usize, &str) {
        let of_check = || {
            let check = self.lowered.checks.get(finding.check?)?;
            let (line, column) = self.source.position(check.span.start);
            Some((line, column, self.source.slice(check.span)))
        };
        let of_task = finding.task.zip(finding.address).and_then(|(task, at)| self.place(task, at));
        let first_line = |span: Span| {
            let (line, column) = self.source.position(span.start);
            (line, column, self.source.slice(span).lines().next().unwrap_or_default())
        };
        let of_couple =
            || finding.couple.and_then(|couple| self.couples.get(couple)).copied().map(first_line);
        // An extern task has no statements.
        let of_head = || finding.task.and_then(|task| self.tasks.get(task.index())).copied().map(first_line);
        of_task.or_else(of_check).or_else(of_couple).or_else(of_head).unwrap_or_else(|| self.head())
    }

    /// The place of the cell's declaration. It is used for a finding that has no other place.
    fn head(&self) -> (usize, usize, &str) {
        let mut lines = (1..).zip(self.source.text().lines());
        let head = lines.find(|(_, text)| text.trim_start().starts_with("cell "));
        let (line, text) = head.unwrap_or((1, ""));
        (line, 1 + text.chars().take_while(|c| c.is_whitespace()).count(), text.trim())
    }
}

/// The model's description of what a task may do.
pub fn conduct(behaviour: &Behaviour) -> Conduct {
    match behaviour {
        Behaviour::Script(script) => {
            let values =
                |values: &[i64]| values.iter().filter_map(|&value| i32::try_from(value).ok()).collect();
            Conduct::Program {
                program: Arc::clone(&script.program),
                values: script.actions.iter().map(|action| values(&action.values)).collect(),
                open: !script.actions.iter().all(Action::is_covered),
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

/// Converts a declared fault hypothesis for the checker, in ticks of `tick_us` microseconds.
pub fn faults(declared: &Faults, table: &CellTable, tick_us: u64) -> CellFaults {
    let pause = |pause: &hir::Pause| {
        // A pause that ends between two ticks ends at the later one.
        let most = pause.most.map(|most| Ticks(most.usec.div_ceil(tick_us.max(1))));
        Pause::new(table, Some(pause.node), most)
    };
    CellFaults {
        loss: declared.loss,
        dup: declared.dup,
        reorder: 0,
        fail: declared.fail,
        drift: declared.drift,
        crash: declared.crash.clone(),
        cut: declared.cut.clone(),
        pause: declared.pause.iter().map(pause).collect(),
    }
}
