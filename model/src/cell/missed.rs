//! Finds the statements that no search reached, and whether they need a fault.

use super::plan::Conduct;
use imrs_protocol::script::{Op, Outcomes, Program, Trigger};

/// The statements of a task that no search reached.
#[derive(Default)]
pub(super) struct Missed {
    /// The number of statements that were reached, and the number of all statements.
    pub counts: (u32, u32),
    /// The unreached statements: for each, its operation, and whether reaching it needs a fault.
    pub statements: Vec<(usize, bool)>,
    /// Whether an unreached statement that needs a fault may affect other statements: after it the task may go on with
    /// values that it has on no other path, or send something.
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
        // The operations that may follow statements which need a fault, on each path up to the first operation that needs
        // no fault.
        let need_fault = statements.iter().filter(|(_, needs_fault)| *needs_fault).map(|&(at, _)| at);
        let code = &program.code;
        let behind =
            reached_from(code, need_fault, |at| if plain[at] { [None; 2] } else { next(&code[at], at) });
        let leads_on = (0..code.len()).any(|at| behind[at] && (plain[at] || is_heard(&code[at])));
        Self { counts, statements, leads_on }
    }
}

/// Whether other tasks, or the activation that a handler has interrupted, can notice the effect of an operation.
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

/// For each operation, whether it is reached although nothing ends badly, and no timer, fence or take-over interrupts the task.
fn needs_no_fault(program: &Program) -> Vec<bool> {
    let messages = program.handlers.iter().filter(|handler| matches!(handler.trigger, Trigger::Message(_)));
    let entries = messages.map(|handler| usize::from(handler.entry)).chain([0]);
    reached_from(&program.code, entries, |at| match program.code[at] {
        // A branch that is taken only for bad outcomes needs a fault. All other branches need none, because a message may
        // come or not.
        Op::On { outcomes, .. } if outcomes.0 & !Outcomes::BAD.0 == 0 => [None, Some(at + 1)],
        op => next(&op, at),
    })
}

/// For each operation, whether control flow reaches it from one of the `entries`. `goes` returns the operations that may
/// follow an operation.
pub(super) fn reached_from(
    code: &[Op],
    entries: impl IntoIterator<Item = usize>,
    goes: impl Fn(usize) -> [Option<usize>; 2],
) -> Vec<bool> {
    let mut open: Vec<usize> = entries.into_iter().collect();
    let mut reached = vec![false; code.len()];
    while let Some(at) = open.pop() {
        if let Some(flag) = reached.get_mut(at).filter(|flag| !**flag) {
            *flag = true;
            open.extend(goes(at).into_iter().flatten());
        }
    }
    reached
}

/// The operations that may follow an operation.
pub(super) fn next(op: &Op, at: usize) -> [Option<usize>; 2] {
    let (there, after) = match *op {
        Op::Jump(to) => (Some(to), false),
        Op::Unless(to) | Op::On { to, .. } => (Some(to), true),
        Op::Abort(_) | Op::End | Op::HandlerEnd => (None, false),
        _ => (None, true),
    };
    [there.map(usize::from), after.then_some(at + 1)]
}
