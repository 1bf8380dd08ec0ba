//! Finds statements that control flow never reaches.

use crate::codes::UNREACHABLE;
use crate::diagnostic::Diagnostic;
use crate::hir::{Hir, Statement, StatementKind};
use crate::walk::{self, goes_on};

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for task in &hir.tasks {
        walk::threads(task).for_each(|thread| unreachable(thread, found));
    }
}

fn unreachable(statements: &[Statement], found: &mut Vec<Diagnostic>) {
    let ends = statements.iter().position(|statement| !goes_on(statement));
    if let Some(at) = ends
        && let Some(next) = statements.get(at + 1)
    {
        let why = match statements[at].kind {
            StatementKind::Abort(_) => "the task ends here",
            StatementKind::Exit => "the loop is left here",
            StatementKind::Loop(_) | StatementKind::While(..) => "this loop has no `exit`",
            _ => "no path leads out of this",
        };
        found.push(
            Diagnostic::warning(UNREACHABLE, next.span, "this statement is never reached")
                .label("never reached")
                .also(head(&statements[at]), why)
                .help("remove it, or let something lead to it"),
        );
    }
    for statement in statements {
        walk::inner(statement).into_iter().for_each(|body| unreachable(body, found));
        statement.branches.iter().for_each(|branch| unreachable(&branch.body, found));
    }
}

/// The span of the first four bytes of a statement, because the diagnostic points only at its beginning.
fn head(statement: &Statement) -> crate::Span {
    crate::Span { start: statement.span.start, end: statement.span.end.min(statement.span.start + 4) }
}
