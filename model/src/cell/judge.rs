//! Judges a move: its findings, and the statements that it reached.

use super::plan::Conduct;
use super::progress::FoundSoFar;
use super::run_state::RunState;
use super::verdict::{Kind, Phase};
use crate::cell_state::script::ScriptReaction;
use crate::state::Violation;
use imrs_protocol::script::{Address, End, Op, Program, ScriptInput, Term};

use imrs_protocol::{CellTable, Outcome, PortId, Signal, Target, TaskId};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A finding (something wrong) of one move, before it becomes a [`Finding`](super::verdict::Finding) with its path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Shown {
    pub kind: Kind,
    pub task: Option<usize>,
    pub address: Option<Address>,
    pub check: Option<usize>,
    pub cause: String,
    /// Whether the search stops after this move.
    pub last: bool,
    /// The couple, by position among the cell's work couples.
    pub couple: Option<usize>,
    /// The other tasks that the finding concerns.
    pub others: Vec<usize>,
}

impl Shown {
    /// A finding about the whole cell, which belongs to no single task.
    pub fn whole(kind: Kind, cause: &str) -> Self {
        let (cause, others) = (cause.into(), Vec::new());
        Self { kind, task: None, address: None, check: None, cause, last: true, couple: None, others }
    }

    /// The finding in the form in which a running search reports it.
    pub fn so_far(&self) -> FoundSoFar<'_> {
        let place = self.task.zip(self.address).map(|(task, at)| (TaskId::from_index(task), at));
        FoundSoFar { kind: self.kind, cause: &self.cause, place }
    }

    /// Whether both findings are the same, whatever moves lead to them.
    pub fn is_same(&self, other: &Self) -> bool {
        let key = |shown: &Self| (shown.kind, shown.task, shown.address, shown.check, shown.couple);
        key(self) == key(other) && (self.kind != Kind::Machine || self.cause == other.cause)
    }
}

/// What a search or a random run has reached.
#[derive(Clone, Debug, Default)]
pub(super) struct Reached {
    /// For each task, which of its operations were reached.
    pub statements: Vec<Vec<bool>>,
    /// For each check, the terms that never changed so far, with their values.
    pub still: Vec<Vec<(Term, Option<i64>)>>,
}

impl Reached {
    /// Joins what two searches have reached.
    pub fn join(mut self, other: Self) -> Self {
        for (all, one) in self.statements.iter_mut().flatten().zip(other.statements.into_iter().flatten()) {
            *all |= one;
        }
        for (all, one) in self.still.iter_mut().zip(&other.still) {
            all.retain(|read| one.contains(read));
        }
        self
    }

    fn note(&mut self, run_state: &RunState) {
        for still in &mut self.still {
            still.retain(|&(term, first)| !run_state.touches(term) || run_state.cell.look_up(term) == first);
        }
    }
}

pub(super) fn nothing_reached(run_state: &RunState) -> Reached {
    let len = |task: &Conduct| match task {
        Conduct::Program { program, .. } => program.code.len(),
        Conduct::Extern(_) => 0,
    };
    let first = |term: Term| (term, run_state.cell.look_up(term));
    Reached {
        statements: run_state.plan.tasks.iter().map(|task| vec![false; len(task)]).collect(),
        still: (0..run_state.plan.checks.len())
            .map(|check| run_state.plan.terms(check).into_iter().map(first).collect())
            .collect(),
    }
}

pub(super) fn program(run_state: &RunState, task: usize) -> Option<&Program> {
    match run_state.plan.tasks.get(task)? {
        Conduct::Program { program, .. } => Some(program),
        Conduct::Extern(_) => None,
    }
}

/// Judges the present state, and what the scripts did since the last call. A panic becomes a violation of the state.
pub(super) fn judge(run_state: &mut RunState, phase: Phase, reached: &mut Reached) -> Vec<Shown> {
    let judged = catch_unwind(AssertUnwindSafe(|| judge_turns(run_state, phase, reached)));
    judged.unwrap_or_else(|_| vec![Shown::whole(Kind::Machine, Violation::Panic.text())])
}

fn judge_turns(run_state: &mut RunState, phase: Phase, reached: &mut Reached) -> Vec<Shown> {
    let turns = run_state.cell.turns.as_mut().map(std::mem::take).unwrap_or_default();
    reached.note(run_state);
    let mut shown = Vec::new();
    for turn in &turns {
        for &at in &turn.passed {
            if let Some(flag) = reached.statements[turn.task].get_mut(usize::from(at)) {
                *flag = true;
            }
        }
        shown.extend(outcome(run_state, turn, phase));
        shown.extend(end(run_state, turn, phase));
    }
    for &check in &run_state.broken {
        let name = &run_state.plan.checks[check].name;
        let cause = format!("`{name}` does not hold");
        shown.push(Shown { check: Some(check), ..Shown::whole(Kind::Check, &cause) });
    }
    if run_state.both_active {
        shown.extend(two_owners(run_state));
    }
    if let Some(violation) = run_state.cell.violation {
        shown.push(Shown::whole(Kind::Machine, violation.text()));
    }
    shown
}

/// The finding that both tasks of a couple act, for the first such couple.
fn two_owners(run_state: &RunState) -> Option<Shown> {
    let couples = &run_state.plan.table.cell().couples;
    let at =
        couples.iter().position(|couple| run_state.acts(couple.primary) && run_state.acts(couple.standby))?;
    let both = [couples[at].primary.index(), couples[at].standby.index()];
    let [primary, standby] = both.map(|task| name(&run_state.plan.table, task));
    let cause = format!("{primary} and {standby} both act");
    Some(Shown { couple: Some(at), others: both.into(), ..Shown::whole(Kind::TwoOwners, &cause) })
}

/// The finding of a request that ended badly in a search without faults.
fn outcome(run_state: &RunState, turn: &ScriptReaction, phase: Phase) -> Option<Shown> {
    let ScriptInput::Signal(signal) = turn.input else { return None };
    if phase == Phase::Faults {
        return None;
    }
    let table = &run_state.plan.table;
    let what = statement(table, program(run_state, turn.task)?, turn.at);
    let name = name(table, turn.task);
    let mut others = None;
    let (kind, cause) = match signal {
        Signal::Outcome(Outcome::Refused) => (Kind::Refused, format!("{name}: {what} is refused")),
        Signal::Outcome(Outcome::TimedOutUnsent | Outcome::TimedOutUnknown | Outcome::PeerRestarted) => {
            (Kind::TimeOut, format!("{name}: {what} ends by its time_out"))
        }
        Signal::Answers { answers, .. } if answers.answered != answers.asked => {
            (Kind::TimeOut, format!("{name}: {what} ends without all answers"))
        }
        // A `receive` with a time_out and a branch only polls. Without a branch the task ends here, and that is a finding.
        Signal::Nothing if !(matches!(turn.end, Some(End::Aborted(_))) && turn.passed.is_empty()) => {
            return None;
        }
        Signal::Nothing => (Kind::TimeOut, format!("{name}: {what} ends by its time_out")),
        Signal::GaveUp { port, missing, .. } => {
            let parties = table.port(port).map_or(&[][..], |port| &port.parties);
            let absent = parties.iter().enumerate().filter(|(i, _)| missing >> i & 1 == 1);
            let absent: Vec<usize> = absent.map(|(_, party)| party.task.index()).collect();
            let others = others.insert(absent);
            let absent: Vec<&str> = others.iter().map(|&task| self::name(table, task)).collect();
            let whom = if absent.is_empty() { "a member".into() } else { absent.join(", ") };
            (Kind::Stranded, format!("{name}: {what} waits in vain for {whom}"))
        }
        Signal::Accepted(_)
        | Signal::Fault(_)
        | Signal::Outcome(Outcome::Reply(_))
        | Signal::Answers { .. }
        | Signal::Interrupt(_)
        | Signal::Granted(_)
        | Signal::Message(_)
        | Signal::Released { .. }
        | Signal::TimeOut(_)
        | Signal::Cancelled => return None,
    };
    let (task, address) = (Some(turn.task), Some(turn.at));
    let others = others.unwrap_or_else(|| partners(run_state, turn.task, turn.at));
    Some(Shown { task, address, others, last: false, ..Shown::whole(kind, &cause) })
}

/// The finding of a script that ended before its last statement.
fn end(run_state: &RunState, turn: &ScriptReaction, phase: Phase) -> Option<Shown> {
    let table = &run_state.plan.table;
    let program = program(run_state, turn.task)?;
    let name = name(table, turn.task);
    let fault_free = phase != Phase::Faults;
    let (kind, address, cause) = match turn.end? {
        // A lease should end only because of a fault. Without a fault, the task that should renew it has
        // ended or is too slow.
        End::Fenced if fault_free => (Kind::LeaseLost, turn.at, format!("{name} lost its lease")),
        End::Finished | End::Fenced => return None,
        End::Assertion(at) => (Kind::Assertion, at, format!("{name}: an assertion does not hold")),
        End::Fault { fault, at } => (Kind::ScriptFault, at, format!("{name}: {fault}")),
        End::Aborted(reason) => {
            let why = program.reasons.get(usize::from(reason)).map_or("", String::as_str);
            // If the script waited at `Op::Statement` for handlers, the statement had begun before this step.
            let begun = program.code.get(usize::from(turn.at)) == Some(&Op::Statement);
            match turn.passed.last().copied().or_else(|| begun.then_some(turn.at)) {
                // The script ended without beginning another statement: a bad outcome had no branch.
                None => (Kind::Ends, turn.at, format!("{name} ends: {why}")),
                Some(at) if fault_free => (Kind::Aborts, at, format!("{name} aborts: {why}")),
                Some(_) => return None,
            }
        }
    };
    let (task, at) = (Some(turn.task), Some(address));
    let others = if kind == Kind::Ends { partners(run_state, turn.task, address) } else { Vec::new() };
    Some(Shown { task, address: at, others, last: fault_free, ..Shown::whole(kind, &cause) })
}

pub(super) fn position(run_state: &RunState, task: usize) -> Address {
    run_state.cell.bodies[task].actor.as_ref().map_or(0, |actor| actor.host.script.position())
}

pub(super) fn name(table: &CellTable, task: usize) -> &str {
    table.cell().tasks.get(task).map_or("?", |task| &task.name)
}

/// An operation in the cell's words.
pub(super) fn statement(table: &CellTable, program: &Program, at: Address) -> String {
    let port = |port: PortId| {
        table
            .cell()
            .ports
            .get(port.index())
            .map_or_else(|| "?".to_string(), |port| format!("`{}`", port.name))
    };
    match program.code.get(usize::from(at)) {
        Some(Op::Send { port: at, to, .. }) => match to {
            Target::One(task) => format!("{} to {}", port(*at), name(table, task.index())),
            _ => port(*at),
        },
        Some(Op::Get { port: Some(at), .. }) => format!("receive {}", port(*at)),
        Some(Op::Get { port: None, .. }) => "receive".into(),
        Some(Op::Reply { .. } | Op::ReplyFor { .. } | Op::ReplyOwed { .. }) => "reply".into(),
        Some(Op::Arrive { port: at, .. }) => format!("waitfor {}", port(*at)),
        Some(Op::Delay(_)) => "delay".into(),
        Some(Op::Run { action, .. }) => {
            format!("run `{}`", program.actions.get(usize::from(*action)).map_or("?", String::as_str))
        }
        Some(Op::Lease) => "its lease".into(),
        _ => "a statement".into(),
    }
}

/// The tasks that should have answered a request that ended badly, or should have sent the message for which it waited.
fn partners(run_state: &RunState, task: usize, at: Address) -> Vec<usize> {
    let peers = |port| {
        let table = &run_state.plan.table;
        let of = TaskId::from_index(task);
        table.port(port).into_iter().flat_map(move |port| port.peers(of)).map(TaskId::index).collect()
    };
    match program(run_state, task).and_then(|program| program.code.get(usize::from(at))) {
        Some(Op::Send { to: Target::One(to), .. }) => vec![to.index()],
        Some(Op::Send { port, .. } | Op::Get { port: Some(port), .. }) => peers(*port),
        _ => Vec::new(),
    }
}
