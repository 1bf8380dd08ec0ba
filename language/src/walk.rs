//! Ways through the statements of a task.

use crate::hir::{Expr, Statement, StatementKind, Task};
use imrs_protocol::script::{Op, Term};

/// Whether a condition is the constant `true`.
pub(crate) fn is_true(condition: &Expr) -> bool {
    condition.ops[..] == [Op::Term(Term::Push(1))]
}

/// The statements in a statement, without those of its branches.
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

/// Each statement, in the order of the text.
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

/// Each statement of a task.
pub(crate) fn of_task<'h>(task: &'h Task, see: &mut dyn FnMut(&'h Statement)) {
    threads(task).for_each(|thread| each(thread, see));
}

/// Whether the task has a statement like this.
pub(crate) fn any(task: &Task, mut is: impl FnMut(&Statement) -> bool) -> bool {
    let mut has = false;
    of_task(task, &mut |statement| has |= is(statement));
    has
}

/// Each statement that runs whenever the thread comes so far: no condition stands before it. Loops are gone through once.
pub(crate) fn certain<'h>(statements: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) {
    for statement in statements {
        see(statement);
        match &statement.kind {
            StatementKind::Atomic(body) | StatementKind::Loop(body) => certain(body, see),
            StatementKind::While(condition, body) if is_true(condition) => {
                certain(body, see);
            }
            _ => {}
        }
    }
}
