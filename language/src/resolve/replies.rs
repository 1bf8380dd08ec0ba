//! Resolves replies to earlier messages, and to messages of other tasks (D11, D93).

use super::STATEMENT;
use super::expr::{self, Typed};
use super::statements::Thread;
use crate::ast::{Expr as Written, Name};
use crate::diagnostic::Diagnostic;
use crate::hir::{Answered, StatementKind};
use crate::span::Span;
use imrs_protocol::script::Type;
use imrs_protocol::{Class, PortId, Usage};

impl<'a> Thread<'_, 'a> {
    /// Resolves `reply grab(true) for r1` and `reply back(7) for r1 ticket n`.
    pub fn reply_for(
        &mut self,
        (response, name): (bool, Option<&'a Name>),
        arguments: &'a [Written],
        (asker, ticket): (&'a Name, Option<&'a Written>),
        span: Span,
    ) -> Option<StatementKind> {
        let word = if response { "response" } else { "reply" };
        let Some(name) = name else {
            let message = format!("`{word} .. for` does not say through which port");
            let found = Diagnostic::error(STATEMENT, asker.span, message)
                .label("its message of which port?")
                .help(format!("write `{word} PORT(..) for {}`", asker.text));
            self.report(found);
            return None;
        };
        let (port, usage) = self.own_port(name)?;
        let number = ticket.map(|ticket| self.number(ticket));
        let task = self.peer(port, asker)?;
        let declared = self.resolver.hir.ports[port.index()].clone();
        let fits = match (usage, ticket) {
            (Usage::Reply, Some(_)) => true,
            (Usage::Receive | Usage::Response, None) => declared.class == Class::Command,
            (Usage::Reply | Usage::Receive | Usage::Response, _)
            | (Usage::Send | Usage::Query | Usage::Waitfor, _) => false,
        };
        if !fits {
            self.cannot_answer(port, usage, name, (asker, ticket));
            return None;
        }
        if response && usage != Usage::Response {
            let found = Diagnostic::error(STATEMENT, span, "`response` to a message that is not a query")
                .label("write `reply`")
                .also(declared.span, "the port")
                .help("`response` answers a query, `reply` a message");
            self.report(found);
            return None;
        }
        let (what, fields) = match usage {
            Usage::Reply => (format!("a message of `{}`", name.text), &declared.message),
            _ => (format!("an answer of `{}`", name.text), &declared.answer),
        };
        let values = self.values(arguments, fields, (&what, span, Some(declared.span)))?;
        let to = match number {
            None => Answered::Of(task),
            Some(number) => Answered::Ticket { asker: task, number: number? },
        };
        Some(StatementKind::Reply { port: Some(port), to, values })
    }

    fn number(&mut self, written: &'a Written) -> Option<crate::hir::Expr> {
        let value = expr::typed(self, written)?;
        expr::coerced(self, value, Type::Word, "the ticket").map(Typed::finish)
    }

    fn cannot_answer(&mut self, port: PortId, usage: Usage, name: &Name, asked: (&Name, Option<&Written>)) {
        let declared = self.resolver.hir.ports[port.index()].span;
        let (asker, ticket) = asked;
        let (at, message, label, help) = match (usage, ticket) {
            (Usage::Reply, _) => (
                asker.span,
                format!("an answer through `{}` needs the ticket of the message", name.text),
                "which of its messages?",
                format!(
                    "write `reply {}(..) for {} ticket n`: the task that took it knows its `ticket`",
                    name.text, asker.text
                ),
            ),
            (Usage::Receive | Usage::Response, Some(ticket)) => (
                ticket.span,
                format!("`{}` is where this task takes messages itself", name.text),
                "no ticket is needed",
                format!("write `reply {}(..) for {}`", name.text, asker.text),
            ),
            (Usage::Receive | Usage::Response, None) => (
                name.span,
                format!("port `{}` is class 1: its sender waits for no answer", name.text),
                "nothing to answer",
                String::from("write `class = 2` at its owner, or remove this"),
            ),
            (Usage::Send | Usage::Query | Usage::Waitfor, _) => (
                name.span,
                format!("`reply` on port `{}`, whose usage here is {usage}", name.text),
                "no message arrives at this end",
                String::from("name the port on which the message arrived"),
            ),
        };
        self.report(
            Diagnostic::error(STATEMENT, at, message).label(label).also(declared, "the port").help(help),
        );
    }
}
