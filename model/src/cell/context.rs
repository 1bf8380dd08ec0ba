//! Adds to a finding the values that explain it, and what the tasks that it concerns do at that time.

use super::judge::{Shown, name, program};
use super::legend::shown;
use super::plan::{Holds, about};
use super::run_state::RunState;
use super::verdict::{Concerned, Kind};
use super::view::view;
use crate::cell_state::script::ScriptReaction;
use imrs_protocol::TaskId;
use imrs_protocol::script::{Activity, Address, End, Op, Predicate, Slot, Term, Variable};
use std::fmt::Write as _;

/// Returns the cause of a finding with the values that explain it, and the tasks that it concerns. `begun` gives the
/// statement that each task began last.
pub(super) fn context(
    run_state: &RunState,
    shown: &Shown,
    begun: &[Option<Address>],
) -> (String, Vec<Concerned>) {
    let values = match shown.kind {
        Kind::Assertion | Kind::ScriptFault => of_statement(run_state, shown),
        Kind::Check => shown.check.map_or_else(Vec::new, |check| of_check(run_state, check)),
        Kind::Deadlock
        | Kind::TimeOut
        | Kind::Starves
        | Kind::Stranded
        | Kind::Refused
        | Kind::Ends
        | Kind::Aborts
        | Kind::LeaseLost
        | Kind::TwoOwners
        | Kind::Unreached
        | Kind::Vacuous
        | Kind::Standstill
        | Kind::WaitsForEver
        | Kind::Machine => Vec::new(),
    };
    let mut cause = shown.cause.clone();
    if !values.is_empty() {
        let _ = write!(cause, ": {}", values.join(", "));
    }
    let mut tasks = shown.others.clone();
    if let Some(check) = shown.check {
        tasks.extend(run_state.plan.terms(check).iter().filter_map(about));
    }
    tasks.sort_unstable();
    tasks.dedup();
    (cause, tasks.into_iter().map(|task| concerned(run_state, task, begun)).collect())
}

fn concerned(run_state: &RunState, task: usize, begun: &[Option<Address>]) -> Concerned {
    let last = begun.get(task).copied().flatten();
    let view = view(run_state, task);
    let (at, does) = match run_state.activity(task).filter(|_| run_state.is_up(task)) {
        Some(Activity::Ended(end)) => (last, ended(run_state, task, end)),
        Some(Activity::NotBegun | Activity::Passive) | None => (None, view.does),
        Some(Activity::Waits | Activity::Acts | Activity::Chooses(_)) => (Some(view.at), view.does),
    };
    Concerned { task: TaskId::from_index(task), at, does }
}

fn ended(run_state: &RunState, task: usize, end: End) -> String {
    match end {
        End::Finished => "has ended: it came to its end".into(),
        End::Fenced => "has ended: it lost its lease".into(),
        End::Assertion(_) => "has ended: its assertion did not hold".into(),
        End::Fault { fault, .. } => format!("has ended: {fault}"),
        End::Aborted(reason) => {
            let reasons = program(run_state, task).map_or(&[][..], |program| &program.reasons);
            format!("has ended: {}", reasons.get(usize::from(reason)).map_or("it aborted", String::as_str))
        }
    }
}

/// The variables that the statement of a finding reads, such as `height = 42`. Variables of handlers are left out, because
/// these variables ended with their activation.
fn of_statement(run_state: &RunState, shown: &Shown) -> Vec<String> {
    let read = || {
        let (task, at) = (shown.task?, usize::from(shown.address?));
        let program = program(run_state, task)?;
        let script = &run_state.cell.bodies.get(task)?.actor.as_ref()?.host.script;
        let begins = program.code.get(..at)?.iter().rposition(|op| *op == Op::Statement).unwrap_or(0);
        let mut values = Vec::new();
        for op in &program.code[begins..=at.min(program.code.len() - 1)] {
            let Op::Term(Term::Load(Slot::Task(variable))) = *op else { continue };
            let Some(declared) = program.variables.get(usize::from(variable)) else { continue };
            values.extend(script.var(variable).map(|value| equals(&declared.name, declared, value)));
        }
        Some(values)
    };
    let mut values = read().unwrap_or_default();
    let mut seen = std::collections::BTreeSet::new();
    values.retain(|value| seen.insert(value.clone()));
    values
}

fn equals(name: &str, declared: &Variable, value: i64) -> String {
    format!("{name} = {}", shown(declared.of, value))
}

/// Explains since when a check is broken, and which task's step broke it.
pub(super) struct Origin {
    check: Option<usize>,
    /// If the left side of a `leads` check has become true and its right side is not true yet: the tick since then, and the
    /// values that the left side read then.
    owed: Option<(u64, Vec<String>)>,
    /// The tasks whose scripts ran in the last step of the path.
    acted: Vec<usize>,
}

impl Origin {
    /// The origin before the first step of a path.
    pub fn new(start: &RunState, check: Option<usize>) -> Self {
        let mut origin = Self { check, owed: None, acted: Vec::new() };
        origin.note(start, &[]);
        origin
    }

    /// Takes note of a step of the path.
    pub fn note(&mut self, run_state: &RunState, turns: &[ScriptReaction]) {
        let Some(check) = self.check else { return };
        self.acted = turns.iter().map(|turn| turn.task).collect();
        self.acted.sort_unstable();
        self.acted.dedup();
        let is_owed = run_state.beside.due.get(check).is_some_and(Option::is_some);
        if run_state.broken.contains(&check) {
            return;
        }
        if !is_owed {
            self.owed = None;
        } else if self.owed.is_none()
            && let Some(Holds::Leads { when, .. }) =
                run_state.plan.checks.get(check).map(|check| &check.holds)
        {
            let read = when.iter().filter_map(|term| value(run_state, *term)).collect();
            self.owed = Some((run_state.passed, read));
        }
    }

    /// The words that say since when the check is broken and by which step, to be appended to the cause of the finding.
    pub fn words(&self, end: &RunState) -> String {
        let Some(holds) = self.check.and_then(|check| end.plan.checks.get(check)).map(|check| &check.holds)
        else {
            return String::new();
        };
        match (holds, &self.owed) {
            (Holds::Leads { .. }, Some((since, read))) => {
                let until = end.passed;
                let read = if read.is_empty() { String::new() } else { format!(" ({})", read.join(", ")) };
                format!(
                    "; its condition held at tick {since}{read}, and what must follow did not by tick {until}"
                )
            }
            (Holds::Always(_), _) if end.mixed.iter().any(|(of, _)| Some(*of) == self.check) => {
                "; so in one tick, in which either node may be the first".into()
            }
            (Holds::Always(_), _) if !self.acted.is_empty() => {
                let tasks: Vec<&str> = self.acted.iter().map(|&task| name(&end.plan.table, task)).collect();
                format!("; it became so at a step of {}", tasks.join(" and "))
            }
            (Holds::Leads { .. }, None) | (Holds::Always(_), _) => String::new(),
        }
    }
}

/// The terms of a check with their values, such as `robot.height = 42`.
fn of_check(run_state: &RunState, check: usize) -> Vec<String> {
    let mixed = run_state.mixed.iter().find(|(of, _)| *of == check).map(|(_, seen)| seen);
    let seen = |term: Term| match mixed {
        Some(seen) => seen.iter().find(|(of, _)| *of == term).and_then(|(_, value)| *value),
        None => run_state.cell.look_up(term),
    };
    run_state.plan.terms(check).into_iter().filter_map(|term| said(run_state, term, seen(term)?)).collect()
}

/// The present value of a term, in the words of the check.
pub(super) fn value(run_state: &RunState, term: Term) -> Option<String> {
    said(run_state, term, run_state.cell.look_up(term)?)
}

fn said(run_state: &RunState, term: Term, value: i64) -> Option<String> {
    let table = &run_state.plan.table;
    let task = |task: TaskId| name(table, task.index());
    let port =
        |port: imrs_protocol::PortId| table.cell().ports.get(port.index()).map_or("?", |port| &port.name);
    let truth = value != 0;
    Some(match term {
        Term::Of { task: of, variable } => {
            let declared = program(run_state, of.index())?.variables.get(usize::from(variable))?;
            equals(&format!("{}.{}", task(of), declared.name), declared, value)
        }
        Term::Is(Predicate::Active(of)) => format!("{}.active = {truth}", task(of)),
        Term::Is(Predicate::Arrived { port: at, task: of }) => {
            format!("{}.arrived({}) = {truth}", port(at), task(of))
        }
        Term::Is(Predicate::Asked { task: of, port: at }) => {
            format!("{}.asked({}) = {truth}", task(of), port(at))
        }
        Term::Is(Predicate::Answered { task: of, port: at }) => {
            format!("{}.answered({}) = {truth}", task(of), port(at))
        }
        _ => return None,
    })
}
