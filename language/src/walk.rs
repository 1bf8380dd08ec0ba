//! Walks over the statements of a task.

use crate::hir::{Expr, Statement, StatementKind, Task};
use imrs_protocol::script::{Op, Term};

/// Whether a condition is the constant `true`.
pub(crate) fn is_true(condition: &Expr) -> bool {
    condition.ops[..] == [Op::Term(Term::Push(1))]
}

/// The inner statements of a statement, without those of its branches.
pub(crate) fn inner(statement: &Statement) -> Vec<&[Statement]> {
    match &statement.kind {
        StatementKind::Atomic(body) | StatementKind::Loop(body) | StatementKind::While(_, body) => vec![body],
        StatementKind::If { arms, otherwise } => {
            arms.iter().map(|(_, body)| &body[..]).chain([&otherwise[..]]).collect()
        }
        StatementKind::Send { .. }
        | StatementKind::Receive { .. }
        | StatementKind::Reply { .. }
        | StatementKind::Waitfor { .. }
        | StatementKind::Order(_)
        | StatementKind::Delay(_)
        | StatementKind::Run { .. }
        | StatementKind::Start { .. }
        | StatementKind::Stop(_)
        | StatementKind::Assign { .. }
        | StatementKind::AssignAll { .. }
        | StatementKind::Publish { .. }
        | StatementKind::Published { .. }
        | StatementKind::Exit
        | StatementKind::Skip
        | StatementKind::Abort(_)
        | StatementKind::Assert(_) => Vec::new(),
    }
}

/// Calls `see` with each statement, in the order of the text.
pub(crate) fn each<'h>(statements: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) {
    for statement in statements {
        see(statement);
        inner(statement).into_iter().for_each(|body| each(body, see));
        statement.branches.iter().for_each(|branch| each(&branch.body, see));
    }
}

/// The threads of a task: its body, its take-over and its handlers.
pub(crate) fn threads(task: &Task) -> impl Iterator<Item = &[Statement]> {
    let handlers = task.handlers.iter().map(|handler| &handler.body[..]);
    [&task.body[..]].into_iter().chain(task.takeover.as_deref()).chain(handlers)
}

/// Calls `see` with each statement of a task.
pub(crate) fn of_task<'h>(task: &'h Task, see: &mut dyn FnMut(&'h Statement)) {
    threads(task).for_each(|thread| each(thread, see));
}

/// Whether `is` holds for a statement of the task.
pub(crate) fn any(task: &Task, mut is: impl FnMut(&Statement) -> bool) -> bool {
    let mut has = false;
    of_task(task, &mut |statement| has |= is(statement));
    has
}

/// Calls `see` with each statement that no condition guards: it runs whenever the thread gets so far. Loops are passed once.
pub(crate) fn certain<'h>(statements: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) {
    let _ = certain_until(statements, see);
}

/// Where a thread certainly goes behind some statements.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Goes {
    /// To the next one.
    On,
    /// Out of the loop around them.
    OutOfLoop,
    /// Nowhere: it has ended, or stays in a loop.
    Nowhere,
}

fn certain_until<'h>(statements: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) -> Goes {
    for statement in statements {
        see(statement);
        let goes = match &statement.kind {
            StatementKind::Abort(_) => Goes::Nowhere,
            StatementKind::Exit => Goes::OutOfLoop,
            StatementKind::Atomic(body) => certain_until(body, see),
            StatementKind::Loop(body) => certain_loop(body, see),
            StatementKind::While(condition, body) if is_true(condition) => certain_loop(body, see),
            _ => Goes::On,
        };
        if goes != Goes::On {
            return goes;
        }
    }
    Goes::On
}

/// A loop that only an `exit` leaves.
fn certain_loop<'h>(body: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) -> Goes {
    match certain_until(body, see) {
        Goes::OutOfLoop => Goes::On,
        Goes::Nowhere => Goes::Nowhere,
        Goes::On => {
            let mut has_exit = false;
            each(body, &mut |statement| has_exit |= matches!(statement.kind, StatementKind::Exit));
            if has_exit { Goes::On } else { Goes::Nowhere }
        }
    }
}
