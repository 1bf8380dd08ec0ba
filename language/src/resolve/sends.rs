//! Resolves the statements that make requests to the communication task, and their branches (R43, D11, D17).

use super::STATEMENT;
use super::statements::{Thread, branch_word};
use crate::ast::{self, BranchKind, Expr as Written, Name, Place, Verb};
use crate::diagnostic::Diagnostic;
use crate::hir::{Answered, Duration, Recipients, StatementKind};
use crate::span::Span;
use imrs_protocol::{Class, PortId, Usage};

impl<'a> Thread<'_, 'a> {
    pub fn send(
        &mut self,
        verb: Verb,
        name: &'a Name,
        arguments: &'a [Written],
        into: &'a [Place],
        within: Option<Duration>,
        span: Span,
    ) -> Option<StatementKind> {
        let (port, usage) = self.own_port(name)?;
        let is_owner = self.resolver.hir.ports[port.index()].owner == self.task;
        if !self.verb_fits(verb, usage, is_owner, name) {
            return None;
        }
        let (to, rest) = self.recipients(port, arguments)?;
        let declared = self.resolver.hir.ports[port.index()].clone();
        let what = format!("a message of `{}`", name.text);
        let values = self.values(rest, &declared.message, (&what, span, Some(declared.span)));
        let several = match &to {
            Recipients::All => declared.peers(self.task).count() > 1,
            Recipients::These(tasks) => tasks.len() > 1,
        };
        if let Some(first) = into.first().filter(|_| several || declared.class == Class::Status) {
            let (message, help) = if several {
                ("several are asked, and each answers", "ask one at a time, or look at `p.answered(t)`")
            } else {
                ("class 1 is not answered", "write `class = 2` at its owner")
            };
            self.report(
                Diagnostic::error(STATEMENT, first.span, message)
                    .label("there is not one answer")
                    .also(declared.span, "the port")
                    .help(help),
            );
            return None;
        }
        let what = format!("an answer of `{}`", name.text);
        let into = self.destinations(into, &declared.answer, (&what, declared.span));
        Some(StatementKind::Send { port, to, values: values?, into: into?, within })
    }

    fn verb_fits(&mut self, verb: Verb, usage: Usage, is_owner: bool, name: &Name) -> bool {
        let said = match verb {
            Verb::Send => "send",
            Verb::UseSend => "use_send",
            Verb::Query => "query",
        };
        let right = match (usage, is_owner) {
            (Usage::Send, true) => "send",
            (Usage::Send, false) => "use_send",
            (Usage::Query, _) => "query",
            (Usage::Receive, _) => "receive",
            (Usage::Response, _) => "on query",
            (Usage::Reply, _) => "reply",
            (Usage::Waitfor, _) => "waitfor",
        };
        if said == right {
            return true;
        }
        let port = self.resolver.ports.get(&name.text).map(|at| self.resolver.hir.ports[at].span);
        let message = format!("`{said}` on port `{}`, whose usage here is {usage}", name.text);
        let mut found = Diagnostic::error(STATEMENT, name.span, message).label(format!("use `{right}`"));
        if let Some(port) = port {
            found = found.also(port, "the port");
        }
        found = found.help(match usage {
            Usage::Send => "`send` is for the owner of a port, `use_send` for its users",
            Usage::Receive | Usage::Query | Usage::Reply | Usage::Response | Usage::Waitfor => {
                "what a task does with a port is decided by the `usage` of its end"
            }
        });
        self.report(found);
        false
    }

    pub fn receive(
        &mut self,
        name: Option<&'a Name>,
        into: &'a [Place],
        from: Option<&'a Name>,
        within: Option<Duration>,
    ) -> Option<StatementKind> {
        let Some(name) = name else {
            self.received = self.unhandled();
            self.received_unknown |= !self.resolver.poisoned_ports.is_empty();
            let from = from.map(|from| self.resolver.task(from));
            if from == Some(None) {
                return None;
            }
            return Some(StatementKind::Receive {
                port: None,
                into: Vec::new(),
                from: from.flatten(),
                within,
            });
        };
        let Some((port, usage)) = self.own_port(name) else {
            self.received_unknown = true;
            return None;
        };
        if !matches!(usage, Usage::Receive | Usage::Response) {
            self.received_unknown = true;
            let declared = self.resolver.hir.ports[port.index()].span;
            let message = format!("`receive` on port `{}`, whose usage here is {usage}", name.text);
            self.report(
                Diagnostic::error(STATEMENT, name.span, message)
                    .label("no message arrives at this end")
                    .also(declared, "the port")
                    .help("receive from a port whose usage here is receive or response"),
            );
            return None;
        }
        let handler = self.handler_of(port);
        if let Some(handler) = handler {
            let message = format!("`receive {}`, but a handler takes its messages", name.text);
            self.report(
                Diagnostic::error(STATEMENT, name.span, message)
                    .label("would wait for nothing")
                    .also(handler, "the handler")
                    .help("keep the one or the other"),
            );
            return None;
        }
        self.received = vec![port];
        let declared = self.resolver.hir.ports[port.index()].clone();
        let what = format!("a message of `{}`", name.text);
        let into = self.destinations(into, &declared.message, (&what, declared.span));
        let from = from.map(|from| self.peer(port, from));
        if from == Some(None) {
            return None;
        }
        Some(StatementKind::Receive { port: Some(port), into: into?, from: from.flatten(), within })
    }

    /// The head of the task's handler for this port's messages.
    fn handler_of(&self, port: PortId) -> Option<Span> {
        let written = self.resolver.written.get(self.task.index())?;
        let name = &self.resolver.hir.ports[port.index()].name;
        written.handlers.iter().find_map(|handler| match &handler.trigger {
            ast::Trigger::Message { port, .. } if port.text == *name => Some(handler.span),
            ast::Trigger::Message { .. }
            | ast::Trigger::Silence { .. }
            | ast::Trigger::Expiry(_)
            | ast::Trigger::Fence => None,
        })
    }

    /// The ports from which a plain `receive` takes messages.
    fn unhandled(&self) -> Vec<PortId> {
        let ports = self.resolver.hir.ports.iter().enumerate();
        let receives = ports
            .filter(|(_, port)| matches!(port.usage_of(self.task), Some(Usage::Receive | Usage::Response)));
        let ids = receives.map(|(at, _)| PortId::from_index(at));
        ids.filter(|&port| self.handler_of(port).is_none() && !self.resolver.heartbeats.contains(&port))
            .collect()
    }

    pub fn reply(
        &mut self,
        response: bool,
        name: Option<&'a Name>,
        arguments: &'a [Written],
        span: Span,
    ) -> Option<StatementKind> {
        let word = if response { "response" } else { "reply" };
        if let Some(name) = name {
            let (port, usage) = self.own_port(name)?;
            if usage == Usage::Reply {
                let declared = self.resolver.hir.ports[port.index()].span;
                let message =
                    format!("`{word}` through `{}` does not say whose message it answers", name.text);
                let found = Diagnostic::error(STATEMENT, span, message)
                    .label("for which task?")
                    .also(declared, "its usage is reply: it answers what another task took")
                    .help(format!("write `reply {}(..) for TASK ticket n`", name.text));
                self.report(found);
                return None;
            }
            self.received.retain(|&received| received == port);
        }
        let commands: Vec<PortId> = self
            .received
            .iter()
            .copied()
            .filter(|port| self.resolver.hir.ports[port.index()].class == Class::Command)
            .collect();
        let queries = |port: &PortId| {
            self.resolver.hir.ports[port.index()].usage_of(self.task) == Some(Usage::Response)
        };
        let Some(&port) = commands.first() else {
            if self.received_unknown {
                return None;
            }
            let found = match self.received.first() {
                None => Diagnostic::error(STATEMENT, span, format!("`{word}` without a message to answer"))
                    .label("nothing was received here")
.help("answer in an `on query` or `on receive`, or behind a `receive`; an earlier message is answered with `reply p(..) for t`"),
                Some(port) => {
                    let port = &self.resolver.hir.ports[port.index()];
                    Diagnostic::error(STATEMENT, span, format!("`{word}` to a message of class 1"))
                        .label("it waits for no answer")
                        .also(port.span, format!("`{}` is class 1", port.name))
                        .help("write `class = 2` there, or remove this")
                }
            };
            self.report(found);
            return None;
        };
        if response && !commands.iter().any(queries) {
            let declared = self.resolver.hir.ports[port.index()].span;
            self.report(
                Diagnostic::error(STATEMENT, span, "`response` to a message that is not a query")
                    .label("write `reply`")
                    .also(declared, "what was received")
                    .help("`response` answers a query, `reply` a message"),
            );
            return None;
        }
        let declared = self.resolver.hir.ports[port.index()].clone();
        let other = commands.iter().map(|port| &self.resolver.hir.ports[port.index()]);
        let other =
            other.into_iter().find(|other| !super::ports::same_types(&other.answer, &declared.answer));
        if let Some(other) = other {
            let message = format!("`{word}` to a message of `{}` or of `{}`", declared.name, other.name);
            let found = Diagnostic::error(STATEMENT, span, message)
                .label("their answers hold different things")
                .also(declared.span, "the one")
                .also(other.span, "the other")
                .help("receive from one port at a time");
            self.report(found);
            return None;
        }
        let what = format!("an answer of `{}`", declared.name);
        let values = self.values(arguments, &declared.answer, (&what, span, Some(declared.span)))?;
        Some(StatementKind::Reply { port: (commands.len() == 1).then_some(port), to: Answered::Last, values })
    }

    pub fn waitfor(
        &mut self,
        name: &'a Name,
        arguments: &'a [Written],
        within: Option<Duration>,
    ) -> Option<StatementKind> {
        let (port, usage) = self.own_port(name)?;
        let declared = self.resolver.hir.ports[port.index()].clone();
        if usage != Usage::Waitfor {
            let message = format!("`waitfor` on port `{}`, whose usage here is {usage}", name.text);
            self.report(
                Diagnostic::error(STATEMENT, name.span, message)
                    .label("no rendezvous")
                    .also(declared.span, "the port")
                    .help("`waitfor` needs a port of usage waitfor"),
            );
            return None;
        }
        let what = format!("an arrival at `{}`", name.text);
        let values = self.values(arguments, &declared.message, (&what, name.span, Some(declared.span)))?;
        Some(StatementKind::Waitfor { port, values, within })
    }

    /// Resolves `alive := p`, which sets what the answers to the heartbeats carry (D61).
    pub fn publish(&mut self, port: PortId, name: &'a Name, value: &'a Written) -> Option<StatementKind> {
        if !self.resolver.heartbeats.contains(&port) {
            if self.resolver.heartbeats_unknown {
                return None;
            }
            let declared = self.resolver.hir.ports[port.index()].span;
            self.report(
                Diagnostic::error(STATEMENT, name.span, format!("`{}` is a port, not a variable", name.text))
                    .label("cannot be assigned")
                    .also(declared, "the port")
                    .help("only the port of a couple's heartbeats is assigned: the value that their answers carry"),
            );
            return None;
        }
        let declared = self.resolver.hir.ports[port.index()].clone();
        if declared.usage_of(self.task).is_none() {
            self.not_declared(port, name);
            return None;
        }
        let values = std::slice::from_ref(value);
        let what = format!("a heartbeat of `{}`", name.text);
        let values = self.values(values, &declared.answer, (&what, value.span, Some(declared.span)))?;
        Some(StatementKind::Publish { port, values })
    }

    /// The heartbeat port that an expression names, if it names one.
    pub fn heartbeats_of(&self, value: &Written) -> Option<PortId> {
        let ast::ExprKind::Path(Place { path, .. }) = &value.kind else { return None };
        let [name] = &path[..] else { return None };
        let port = self.resolver.ports.get(&name.text).filter(|_| !self.scope.has(&name.text));
        port.map(PortId::from_index).filter(|port| self.resolver.heartbeats.contains(port))
    }

    /// Resolves `p := alive`, which reads the record that the other task of the couple last sent with its heartbeats (D61).
    pub fn published(&mut self, port: PortId, place: &'a Place) -> Option<StatementKind> {
        let declared = self.resolver.hir.ports[port.index()].clone();
        if declared.usage_of(self.task).is_none() {
            self.not_declared(port, &ast::Name { text: declared.name, span: place.span });
            return None;
        }
        let places = std::slice::from_ref(place);
        let what = format!("a heartbeat of `{}`", declared.name);
        let into = self.destinations(places, &declared.answer, (&what, declared.span))?;
        Some(StatementKind::Published { port, into })
    }

    /// Reports a branch for an outcome that the statement cannot have.
    pub fn branch_fits(&mut self, statement: &StatementKind, branch: &ast::Branch) {
        let port = |port: PortId| &self.resolver.hir.ports[port.index()];
        let (fits, why) = match (statement, branch.when) {
            (StatementKind::Send { port: id, .. }, _) if port(*id).class == Class::Status => {
                (false, "class 1 is sent and forgotten")
            }
            (StatementKind::Send { .. }, BranchKind::TimeOut) => (true, ""),
            (StatementKind::Send { port: id, to, .. }, BranchKind::Refused) => {
                let several = match to {
                    Recipients::All => port(*id).peers(self.task).count() > 1,
                    Recipients::These(tasks) => tasks.len() > 1,
                };
                (!several, "several are asked: use `on time_out` and `p.refused(t)`")
            }
            (StatementKind::Receive { port: id, within, .. }, BranchKind::TimeOut) => {
                let own = id.and_then(|id| port(id).user(self.task)).and_then(|user| user.time_out);
                (within.is_some() || own.is_some(), "it waits without end: add `within ..`")
            }
            (StatementKind::Waitfor { .. }, BranchKind::TimeOut) => (true, ""),
            (StatementKind::Run { .. } | StatementKind::Reply { .. }, BranchKind::Failed) => (true, ""),
            (
                StatementKind::Send { .. }
                | StatementKind::Receive { .. }
                | StatementKind::Reply { .. }
                | StatementKind::Waitfor { .. }
                | StatementKind::Order(_)
                | StatementKind::Delay(_)
                | StatementKind::Run { .. }
                | StatementKind::Start { .. }
                | StatementKind::Stop(_)
                | StatementKind::Atomic(_)
                | StatementKind::Assign { .. }
                | StatementKind::AssignAll { .. }
                | StatementKind::Publish { .. }
                | StatementKind::Published { .. }
                | StatementKind::If { .. }
                | StatementKind::Loop(_)
                | StatementKind::While(..)
                | StatementKind::Exit
                | StatementKind::Skip
                | StatementKind::Abort(_)
                | StatementKind::Assert(_),
                _,
            ) => (false, "this statement never ends so"),
        };
        if !fits {
            let message = format!("`{}` is never taken here", branch_word(branch.when));
            self.report(
                Diagnostic::error(STATEMENT, branch.span, message).label(why).help("remove this branch"),
            );
        }
    }
}
