//! `--paper`: reports what the paper's figures and text do not have. `node`, `link` and `tick` are allowed, because a cell
//! needs a network, hosts and a tick, which the paper leaves open.

use crate::ast::{
    BranchKind, File, Handler, Item, PortOptionKind, Statement, StatementKind, TaskDecl, Trigger,
};
use crate::codes::NOT_IN_THE_PAPER;
use crate::diagnostic::Diagnostic;
use crate::lexer::{Kind, lex};
use crate::report::Report;
use crate::source::Source;
use crate::span::Span;
use crate::words::Word;

/// The diagnostics for everything in a file that the paper has no word for.
pub(crate) fn paper(file: &File, source: &Source) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    let mut see = |word: &str, span: Span| {
        let help = match word {
            "penalty" => "write `penalty = paper ..`: the Appendix's TIME_PENALTY",
            "us" | "ms" | "s" => "write `usec`, `msec` or `sec`, or leave `--paper` out",
            _ => "remove it, or leave `--paper` out",
        };
        found.push(
            Diagnostic::error(NOT_IN_THE_PAPER, span, format!("`{word}` is not a keyword of the paper"))
                .label("not under `--paper`")
                .help(help),
        );
    };
    // Lexing reports no errors here, because the text was parsed before.
    for (kind, span) in lex(source.text(), &mut Report::default()).tokens {
        let text = source.slice(span);
        if matches!(kind, Kind::Word(_)) && Word::short_unit(text).is_some() {
            see(text, span);
        }
    }
    for item in &file.items {
        match item {
            Item::Couple(couple) => see("couple", couple.span),
            Item::Faults(faults) => see("faults", faults.span),
            Item::Check(check) => see("check", check.span),
            Item::Task(task) => of_task(task, &mut see),
            Item::Tick(tick) if tick.model => see("model", tick.span),
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
            Trigger::Expiry(_) => see("expiry", *span),
            Trigger::Message { .. } => {}
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
        let span = statement.span;
        match &statement.kind {
            StatementKind::Run { .. } => see("run", span),
            StatementKind::Start { .. } => see("start", span),
            StatementKind::Stop(_) => see("stop", span),
            StatementKind::Assert(_) => see("assert", span),
            StatementKind::Abort(_) => see("abort", span),
            StatementKind::Atomic(body) => {
                see("atomic", span);
                statements(body, see);
            }
            StatementKind::Loop(body) | StatementKind::While(_, body) => statements(body, see),
            StatementKind::If { arms, otherwise } => {
                arms.iter().for_each(|(_, body)| statements(body, see));
                otherwise.iter().for_each(|body| statements(body, see));
            }
            StatementKind::Send { within, .. } | StatementKind::Waitfor { within, .. } => {
                within.iter().for_each(|within| see("within", within.span));
            }
            StatementKind::Receive { from, within, .. } => {
                from.iter().for_each(|from| see("from", from.span));
                within.iter().for_each(|within| see("within", within.span));
            }
            StatementKind::Reply { asker, .. } => {
                asker.iter().for_each(|asker| see("for", asker.span));
            }
            StatementKind::Order(_)
            | StatementKind::Delay(_)
            | StatementKind::Assign { .. }
            | StatementKind::Exit
            | StatementKind::Skip => {}
        }
        for branch in &statement.branches {
            match branch.when {
                BranchKind::Refused => see("refused", branch.span),
                BranchKind::Failed => see("failed", branch.span),
                BranchKind::TimeOut => {}
            }
            statements(&branch.body, see);
        }
    }
}
