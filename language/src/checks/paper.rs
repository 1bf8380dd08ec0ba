//! `--paper`: only what the paper's figures and text have. The network, the tick and the host are no part of them, so `node`,
//! `link` and `tick` stay: without them there is no cell.

use crate::ast::{File, Handler, Item, PortOptionKind, Statement, StatementKind, TaskDecl, Trigger};
use crate::codes::NOT_IN_THE_PAPER;
use crate::diagnostic::Diagnostic;
use crate::span::Span;

/// Everything in a file that the paper has no word for.
pub(crate) fn paper(file: &File) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    let mut see = |word: &str, span: Span| {
        found.push(
            Diagnostic::error(NOT_IN_THE_PAPER, span, format!("`{word}` is no word of the paper"))
                .label("not under `--paper`")
                .help("remove it, or check without `--paper`"),
        );
    };
    for item in &file.items {
        match item {
            Item::Couple(couple) => see("couple", couple.span),
            Item::Faults(faults) => see("faults", faults.span),
            Item::Check(check) => see("check", check.span),
            Item::Task(task) => of_task(task, &mut see),
            Item::Tick(_) | Item::Link(_) | Item::Node(_) | Item::Type(_) => {}
        }
    }
    found.sort_by_key(|diagnostic| diagnostic.primary.span);
    found
}

fn of_task(task: &TaskDecl, see: &mut dyn FnMut(&str, Span)) {
    if let Some(of) = &task.standby_of {
        see("standby", of.span);
    }
    if let Some(span) = task.is_extern {
        see("extern", span);
    }
    for option in task.ports.iter().flat_map(|port| &port.options) {
        let word = match &option.kind {
            PortOptionKind::Retry(_) => "retry",
            PortOptionKind::Resend(_) => "resend",
            PortOptionKind::Penalty { literal: false, .. } => "penalty",
            PortOptionKind::Rate(_) => "rate",
            PortOptionKind::Latest => "latest",
            PortOptionKind::Usage(_)
            | PortOptionKind::MessageFormat(_)
            | PortOptionKind::UserList(_)
            | PortOptionKind::TimeOut(_)
            | PortOptionKind::Class(_)
            | PortOptionKind::BoundedBuffer(_)
            | PortOptionKind::Penalty { literal: true, .. } => continue,
        };
        see(word, option.span);
    }
    for Handler { trigger, body, span } in &task.handlers {
        match trigger {
            Trigger::Silence { .. } => see("silence", *span),
            Trigger::Fence => see("fence", *span),
            Trigger::Message { .. } | Trigger::Expiry(_) => {}
        }
        statements(body, see);
    }
    statements(&task.body, see);
    if let Some(takeover) = &task.takeover {
        see("takeover", task.name.span);
        statements(takeover, see);
    }
}

fn statements(body: &[Statement], see: &mut dyn FnMut(&str, Span)) {
    for statement in body {
        match &statement.kind {
            StatementKind::Run { .. } => see("run", statement.span),
            StatementKind::Start { .. } => see("start", statement.span),
            StatementKind::Stop(_) => see("stop", statement.span),
            StatementKind::Assert(_) => see("assert", statement.span),
            StatementKind::Atomic(body) | StatementKind::Loop(body) | StatementKind::While(_, body) => {
                statements(body, see);
            }
            StatementKind::If { arms, otherwise } => {
                arms.iter().for_each(|(_, body)| statements(body, see));
                otherwise.iter().for_each(|body| statements(body, see));
            }
            StatementKind::Send { .. }
            | StatementKind::Receive { .. }
            | StatementKind::Reply { .. }
            | StatementKind::Waitfor { .. }
            | StatementKind::Order(_)
            | StatementKind::Delay(_)
            | StatementKind::Assign { .. }
            | StatementKind::Exit
            | StatementKind::Skip
            | StatementKind::Abort(_) => {}
        }
        statement.branches.iter().for_each(|branch| statements(&branch.body, see));
    }
}
