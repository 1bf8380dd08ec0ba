//! Compiles cells from texts and checks them.

use imrs_language::hir::CoupleKind;
use imrs_language::lower::{Action, Behaviour, CheckKind, Lowered, Script};
use imrs_language::{Source, Unit, compile};
use imrs_model::cell::{
    Budget, CellCheck, CellFaults, CellPlan, Conduct, Finding, Holds, Kind, Pause, Verdicts, check_cell,
};
use imrs_protocol::script::Address;
use imrs_protocol::{CellTable, TaskId, Ticks};
use std::sync::Arc;

/// A budget that bounds a search by states. If seconds bounded the search, it could end early on a busy machine, or use
/// coarser times.
pub const fn within(states: u64) -> Budget {
    Budget { states, seconds: f64::INFINITY, bytes: 4 << 30 }
}

/// Whether two findings are about the same statement or check, even if they name different tasks with equal statements.
/// Starvation counts as a time_out, because the search examines only one path to decide between the two.
pub fn is_alike(one: &Finding, other: &Finding) -> bool {
    let about = |finding: &Finding| {
        let kind = if finding.kind == Kind::Starves { Kind::TimeOut } else { finding.kind };
        (kind, finding.address, finding.check, finding.couple)
    };
    let tasks = |finding: &Finding| [finding.task.as_slice(), &finding.also].concat();
    let (some, others) = (tasks(one), tasks(other));
    about(one) == about(other) && (some == others || some.iter().any(|task| others.contains(task)))
}

/// A cell, with the text from which it was compiled.
pub struct Text {
    text: String,
    lowered: Lowered,
    /// The offsets at which the declarations of work couples begin in the text.
    couples: Vec<u32>,
    pub plan: CellPlan,
}

impl Text {
    /// Compiles a cell for the checker.
    pub fn new(text: &str) -> Self {
        let source = Source::new(text.as_bytes()).expect("text");
        let compiled = compile(&source);
        let lowered = compiled.lower(Unit::Ticks).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
        let table = Arc::new(CellTable::new(lowered.cell.clone()).expect("a sound table"));
        let conduct = |behaviour: &Behaviour| match behaviour {
            Behaviour::Script(script) => Conduct::Program {
                program: Arc::clone(&script.program),
                values: script.actions.iter().map(|action| values(&action.values)).collect(),
                open: !script.actions.iter().all(Action::is_covered),
            },
            Behaviour::Extern(rate) => Conduct::Extern(*rate),
        };
        let tasks = lowered.tasks.iter().map(conduct).collect();
        let mut plan = CellPlan::new(Arc::clone(&table), tasks);
        plan.budget = within(1_000_000);
        let tick = compiled.hir.as_ref().map_or(1, |hir| Unit::Ticks.usec(hir));
        let pause = |pause: &imrs_language::hir::Pause| {
            let most = pause.most.map(|most| Ticks(most.usec.div_ceil(tick)));
            Pause::new(&table, Some(pause.node), most)
        };
        let hypothesis = |faults: &imrs_language::hir::Faults| CellFaults {
            loss: faults.loss,
            dup: faults.dup,
            fail: faults.fail,
            drift: faults.drift,
            crash: faults.crash.clone(),
            cut: faults.cut.clone(),
            pause: faults.pause.iter().map(pause).collect(),
            ..CellFaults::default()
        };
        plan.faults = lowered.faults.iter().map(hypothesis).collect();
        let check = |check: &imrs_language::lower::Check| CellCheck {
            name: check.name.clone(),
            holds: match &check.kind {
                CheckKind::Always(terms) => Holds::Always(terms.clone()),
                CheckKind::Leads { when, then, within } => {
                    Holds::Leads { when: when.clone(), then: then.clone(), within: *within }
                }
            },
        };
        plan.checks = lowered.checks.iter().map(check).collect();
        let line = |span: &imrs_language::Span| u32::try_from(source.position(span.start).0).expect("a line");
        for task in &lowered.tasks {
            let (lines, handlers) = match task {
                Behaviour::Script(script) => {
                    (script.spans.iter().map(line).collect(), script.handlers.iter().map(line).collect())
                }
                Behaviour::Extern(_) => (Vec::new(), Vec::new()),
            };
            plan.legend.lines.push(lines);
            plan.legend.handlers.push(handlers);
        }
        let formats = lowered.formats.iter();
        plan.legend.formats = formats.map(|port| (port.message.clone(), port.answer.clone())).collect();
        let couples = compiled.hir.iter().flat_map(|hir| &hir.couples);
        let couples = couples.filter(|couple| matches!(couple.kind, CoupleKind::Work { .. }));
        let couples = couples.map(|couple| couple.span.start).collect();
        Self { text: text.into(), lowered, couples, plan }
    }

    /// Checks the cell with the model checker.
    pub fn check(&self) -> Verdicts {
        let verdicts = check_cell(&Arc::new(self.plan.clone()));
        for phase in &verdicts.phases {
            println!("{phase:?}");
        }
        println!("statements {:?}, not seen {:?}", verdicts.statements, verdicts.not_seen);
        for finding in &verdicts.findings {
            println!(
                "{:?} {:?} at {}: {} | {}",
                finding.kind,
                finding.phase,
                finding.at_ticks,
                finding.cause,
                self.source(finding)
            );
            if std::env::var_os("CELL_CHARTS").is_some() {
                println!("{}", finding.chart);
            }
        }
        verdicts
    }

    /// Whether the search without faults, with which every check begins, is too large. Then the check cannot be complete,
    /// and it is not worth beginning the searches with faults.
    pub fn is_too_large_without_faults(&self) -> bool {
        let mut plan = self.plan.clone();
        plan.faults.clear();
        !check_cell(&Arc::new(plan)).is_complete()
    }

    /// The text of the statement at which a finding points.
    pub fn source(&self, finding: &Finding) -> &str {
        let (Some(task), Some(at)) = (finding.task, finding.address) else { return "" };
        let Behaviour::Script(script) = &self.lowered.tasks[task.index()] else { return "" };
        let Script { spans, .. } = &**script;
        let span = spans[usize::from(at)];
        &self.text[span.range()]
    }

    /// Line and column, from 1, of the place at which a finding points: its statement, its check, or its couple.
    pub fn place(&self, finding: &Finding) -> Option<(usize, usize)> {
        let of_check = || Some(self.lowered.checks.get(finding.check?)?.span.start);
        let of_task = || match &self.lowered.tasks[finding.task?.index()] {
            Behaviour::Script(script) => {
                script.spans.get(usize::from(finding.address?)).map(|span| span.start)
            }
            Behaviour::Extern(_) => None,
        };
        let of_couple = || self.couples.get(finding.couple?).copied();
        Some(self.position(of_task().or_else(of_check).or_else(of_couple)?))
    }

    /// Line and column, from 1, of an operation of a task.
    pub fn place_of(&self, task: TaskId, at: Address) -> Option<(usize, usize)> {
        let Behaviour::Script(script) = &self.lowered.tasks[task.index()] else { return None };
        Some(self.position(script.spans.get(usize::from(at))?.start))
    }

    fn position(&self, start: u32) -> (usize, usize) {
        Source::new(self.text.as_bytes()).expect("text").position(start)
    }

    /// The findings, each with its kind and the beginning of the statement at which it points.
    pub fn found(&self, verdicts: &Verdicts) -> Vec<(Kind, String)> {
        let short = |finding: &Finding| {
            let line = self.source(finding).lines().next().unwrap_or_default();
            (finding.kind, line.chars().take(24).collect())
        };
        verdicts.findings.iter().map(short).collect()
    }
}

fn values(values: &[i64]) -> Vec<i32> {
    values.iter().filter_map(|&value| i32::try_from(value).ok()).collect()
}
