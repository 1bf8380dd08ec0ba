//! Functions that visit the statements of a task.

use crate::hir::{Expr, Statement, StatementKind, Task};
use imrs_protocol::script::{Op, Term};

/// Whether a condition is the constant `true`.
pub(crate) fn is_true(condition: &Expr) -> bool {
    condition.ops[..] == [Op::Term(Term::Push(1))]
}

/// The statements inside a statement, but not the statements of its branches.
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

/// The `order`s at the beginning of a task's body, and the statements behind them.
pub(crate) fn orders_and_rest(task: &Task) -> (&[Statement], &[Statement]) {
    let is_order = |statement: &&Statement| matches!(statement.kind, StatementKind::Order(_));
    task.body.split_at(task.body.iter().take_while(is_order).count())
}

/// Whether the body of a task only waits for ever in a plain `receive`, so that its handlers do all its work.
pub(crate) fn only_serves(task: &Task) -> bool {
    orders_and_rest(task).1.is_empty() && !task.handlers.is_empty()
}

/// Calls `see` with each statement of a task.
pub(crate) fn of_task<'h>(task: &'h Task, see: &mut dyn FnMut(&'h Statement)) {
    threads(task).for_each(|thread| each(thread, see));
}

/// Whether `is` holds for at least one statement of the task.
pub(crate) fn any(task: &Task, mut is: impl FnMut(&Statement) -> bool) -> bool {
    let mut has = false;
    of_task(task, &mut |statement| has |= is(statement));
    has
}

/// Calls `see` with each statement that stands under no condition, so that it runs whenever the thread reaches it. The
/// body of a loop is visited once.
pub(crate) fn certain<'h>(statements: &'h [Statement], see: &mut dyn FnMut(&'h Statement)) {
    for statement in statements {
        see(statement);
        match &statement.kind {
            StatementKind::Atomic(body) | StatementKind::Loop(body) => certain(body, see),
            StatementKind::While(condition, body) if is_true(condition) => certain(body, see),
            _ => {}
        }
        if !goes_on(statement) {
            return;
        }
    }
}

/// Whether control flow may continue behind this statement.
pub(crate) fn goes_on(statement: &Statement) -> bool {
    let by_branch = statement.branches.iter().any(|branch| all_go_on(&branch.body));
    by_branch
        || match &statement.kind {
            StatementKind::Abort(_) | StatementKind::Exit => false,
            StatementKind::Atomic(body) => all_go_on(body),
            StatementKind::Loop(body) => has_exit(body),
            StatementKind::While(condition, body) => !is_true(condition) || has_exit(body),
            StatementKind::If { arms, otherwise } => {
                arms.iter().any(|(_, body)| all_go_on(body)) || all_go_on(otherwise)
            }
            _ => true,
        }
}

/// Whether control flow may continue behind these statements.
pub(crate) fn all_go_on(statements: &[Statement]) -> bool {
    statements.iter().all(goes_on)
}

/// Whether the body has an `exit` that leaves this loop. An `exit` of an inner loop does not leave this loop.
fn has_exit(body: &[Statement]) -> bool {
    body.iter().any(|statement| {
        let own = match &statement.kind {
            StatementKind::Exit => true,
            StatementKind::Loop(_) | StatementKind::While(..) => false,
            _ => inner(statement).into_iter().any(has_exit),
        };
        own || statement.branches.iter().any(|branch| has_exit(&branch.body))
    })
}
