//! Finds the statements that no search reached, and whether they need a fault.

use super::plan::Conduct;
use imrs_protocol::script::{Op, Outcomes, Program, Trigger};

/// The statements of a task that no search reached.
#[derive(Default)]
pub(super) struct Missed {
    /// The number of statements reached, and of all statements.
    pub counts: (u32, u32),
    /// The unreached statements: the operation, and whether it needs a fault.
    pub statements: Vec<(usize, bool)>,
    /// Whether an unreached statement that needs a fault may affect others: the task goes on with values that it has on no other
    /// path, or sends something.
    pub leads_on: bool,
}

impl Missed {
    pub fn of(conduct: &Conduct, reached: impl Fn(usize) -> bool) -> Self {
        let Conduct::Program { program, .. } = conduct else { return Self::default() };
        let plain = needs_no_fault(program);
        let all: Vec<usize> =
            (0..program.code.len()).filter(|&at| program.code[at] == Op::Statement).collect();
        let statements: Vec<_> = all.iter().filter(|&&at| !reached(at)).map(|&at| (at, !plain[at])).collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let counts = (count(all.len() - statements.len()), count(all.len()));
        let mut missed = Self { counts, statements, ..Self::default() };
        for &(at, _) in missed.statements.iter().filter(|(_, needs_fault)| *needs_fault) {
            missed.leads_on |=
                behind(program, at, &plain).iter().any(|&at| plain[at] || is_heard(&program.code[at]));
        }
        missed
    }
}

/// Whether other tasks, or the activation that a handler has interrupted, may notice an operation.
fn is_heard(op: &Op) -> bool {
    matches!(
        op,
        Op::Send { .. }
            | Op::Reply { .. }
            | Op::ReplyFor { .. }
            | Op::ReplyOwed { .. }
            | Op::Arrive { .. }
            | Op::Publish { .. }
            | Op::HandlerEnd
    )
}

/// The operations that may follow one that needs a fault, on each path up to the first one that needs none.
fn behind(program: &Program, from: usize, plain: &[bool]) -> Vec<usize> {
    let (mut open, mut found) = (vec![from], Vec::new());
    while let Some(at) = open.pop() {
        if at >= program.code.len() || found.contains(&at) {
            continue;
        }
        found.push(at);
        if !plain[at] {
            open.extend(next(&program.code[at], at));
        }
    }
    found
}

/// For each operation, whether it is reached although nothing ends badly, and no timer, fence or take-over interrupts the task.
fn needs_no_fault(program: &Program) -> Vec<bool> {
    let messages = program.handlers.iter().filter(|handler| matches!(handler.trigger, Trigger::Message(_)));
    let mut open: Vec<usize> = messages.map(|handler| usize::from(handler.entry)).collect();
    open.push(0);
    let mut reached = vec![false; program.code.len()];
    while let Some(at) = open.pop() {
        let Some(flag) = reached.get_mut(at).filter(|flag| !**flag) else { continue };
        *flag = true;
        match program.code[at] {
            // A branch that takes only bad outcomes needs a fault. All others do not: a message may come or not.
            Op::On { outcomes, .. } if outcomes.0 & !Outcomes::BAD.0 == 0 => open.push(at + 1),
            op => open.extend(next(&op, at)),
        }
    }
    reached
}

/// The operations that may follow an operation.
pub(super) fn next(op: &Op, at: usize) -> impl Iterator<Item = usize> {
    let (there, after) = match *op {
        Op::Jump(to) => (Some(to), false),
        Op::Unless(to) | Op::On { to, .. } => (Some(to), true),
        Op::Abort(_) | Op::End | Op::HandlerEnd => (None, false),
        _ => (None, true),
    };
    there.map(usize::from).into_iter().chain(after.then_some(at + 1))
}
