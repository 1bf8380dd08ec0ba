//! Resolves the options of ports, and checks which options fit the port (Figures 1 and 2, D9).

use super::ports::Options;
use super::{OPTION, Resolver};
use crate::ast::{self, PortDecl, PortOptionKind};
use crate::diagnostic::Diagnostic;
use crate::hir::Duration;
use crate::span::Span;
use imrs_protocol::{Class, Usage};

impl<'a> Resolver<'a> {
    /// The options of a port's declaration. Reports options that are given twice, and options of a user that only the owner
    /// may give.
    pub(super) fn options(&mut self, decl: &'a PortDecl) -> Options<'a> {
        let mut options = Options::default();
        let mut seen: Vec<(&'static str, Span)> = Vec::new();
        for option in &decl.options {
            let (word, of_owner) = word(&option.kind);
            if let Some(&(_, first)) = seen.iter().find(|(other, _)| *other == word) {
                self.report(
                    Diagnostic::error(OPTION, option.span, format!("`{word}` is given twice"))
                        .label("the second one")
                        .also(first, "the first one")
                        .help("remove one of them"),
                );
                continue;
            }
            seen.push((word, option.span));
            if of_owner && !decl.owner {
                self.report(
                    Diagnostic::error(
                        OPTION,
                        option.span,
                        format!("`{word}` belongs to the owner of a port"),
                    )
                    .label("not an option of `use_port`")
                    .help(format!("write it at `port {}`", decl.name.text)),
                );
                continue;
            }
            self.option(option, &mut options);
        }
        options
    }

    fn option(&mut self, option: &'a ast::PortOption, options: &mut Options<'a>) {
        match &option.kind {
            PortOptionKind::Usage(usage) => options.usage = Some((*usage, option.span)),
            PortOptionKind::MessageFormat(name) => options.format = Some(name),
            PortOptionKind::UserList(names) => options.user_list = Some((names, option.span)),
            PortOptionKind::TimeOut(length) => options.time_out = self.some_time("time_out", *length),
            PortOptionKind::Class(number) => {
                options.class = match number.value {
                    1 => Some((Class::Status, option.span)),
                    2 => Some((Class::Command, option.span)),
                    other => {
                        self.report(
                            Diagnostic::error(OPTION, number.span, format!("there is no class {other}"))
                                .label("1 or 2")
                                .help("class 1 informs and is not answered; class 2 commands and is"),
                        );
                        options.broken = true;
                        None
                    }
                }
            }
            PortOptionKind::BoundedBuffer(number) => options.buffer = Some(*number),
            PortOptionKind::Retry(number) => options.retry = Some(*number),
            PortOptionKind::Resend(length) => {
                options.resend = self.some_time("resend", *length).map(|length| (length, option.span));
            }
            PortOptionKind::Penalty { literal, length } => {
                options.penalty = Some((*length, *literal, option.span));
            }
            PortOptionKind::Rate(rate) => options.rate = self.rate(rate),
            PortOptionKind::Latest => options.latest = Some(option.span),
        }
    }

    /// Reports a duration of zero.
    pub(super) fn some_time(&mut self, what: &str, length: Duration) -> Option<Duration> {
        if length.usec == 0 {
            self.report(
                Diagnostic::error(OPTION, length.span, format!("a `{what}` of no time"))
                    .label("must be longer than 0")
                    .help("write how long, such as `20 msec`"),
            );
        }
        Some(length)
    }

    pub(super) fn rate(&mut self, rate: &ast::Rate) -> Option<(u16, Duration)> {
        self.some_time("rate", rate.per);
        match u16::try_from(rate.count.value) {
            Ok(count) if count > 0 => Some((count, rate.per)),
            _ => {
                self.report(
                    Diagnostic::error(OPTION, rate.count.span, format!("a rate of {}", rate.count.value))
                        .label("1 to 65535")
                        .help("write how many messages in which time: `rate = 20/1 sec`"),
                );
                None
            }
        }
    }

    pub(super) fn buffer(&mut self, number: ast::Number) -> u16 {
        match u16::try_from(number.value) {
            Ok(n) if n > 0 => n,
            _ => {
                self.report(
                    Diagnostic::error(OPTION, number.span, format!("a buffer for {} messages", number.value))
                        .label("1 to 65535")
                        .help("a message that arrives while the task is busy needs a place"),
                );
                1
            }
        }
    }

    pub(super) fn retry(&mut self, number: ast::Number) -> u8 {
        u8::try_from(number.value).unwrap_or_else(|_| {
            self.report(
                Diagnostic::error(OPTION, number.span, format!("retry = {}", number.value))
                    .label("at most 255")
                    .help("write how often it is sent again, such as 2"),
            );
            u8::MAX
        })
    }

    /// The class of a port: if messages are answered, the port has class 2 (§3, D7).
    pub(super) fn class(
        &mut self,
        decl: &'a PortDecl,
        usage: Usage,
        options: &Options<'a>,
        usage_span: Span,
    ) -> Class {
        let answered = match usage {
            Usage::Waitfor | Usage::Query | Usage::Response | Usage::Reply => true,
            Usage::Send | Usage::Receive => false,
        };
        match options.class {
            Some((Class::Status, span)) if answered => {
                self.report(
                    Diagnostic::error(
                        OPTION,
                        span,
                        format!("port `{}` waits for an answer, so it cannot be class 1", decl.name.text),
                    )
                    .label("class 1 is not answered")
                    .also(usage_span, format!("`{usage}` is"))
                    .help("write `class = 2`"),
                );
                Class::Command
            }
            Some((class, _)) => class,
            None if answered => Class::Command,
            None => Class::Status,
        }
    }

    /// Reports options that have no meaning for the port's usage.
    pub(super) fn fitting(&mut self, decl: &'a PortDecl, usage: Usage, options: &Options<'a>) {
        let class = options.class.map(|(class, _)| class);
        if let (Some(retry), Usage::Send | Usage::Receive, None | Some(Class::Status)) =
            (options.retry, usage, class)
            && retry.value > 0
        {
            self.report(
                Diagnostic::error(
                    OPTION,
                    retry.span,
                    format!("port `{}` is class 1: no answer shows what to send again", decl.name.text),
                )
                .label("needs an answer that may be missing")
                .help("write `class = 2`, or leave `retry` out"),
            );
        }
        let waitfor = usage == Usage::Waitfor;
        let idle = [
            options.buffer.filter(|_| waitfor).map(|n| ("bounded_buffer", n.span)),
            options.latest.filter(|_| waitfor).map(|span| ("latest", span)),
            options.penalty.filter(|_| waitfor).map(|(_, _, span)| ("penalty", span)),
        ];
        for (word, span) in idle.into_iter().flatten() {
            self.report(
                Diagnostic::error(OPTION, span, format!("a waitfor has no `{word}`"))
                    .label("arrivals do not wait in a buffer")
                    .help("remove it"),
            );
        }
    }
}

/// The keyword of an option, and whether only the owner may give it.
const fn word(kind: &PortOptionKind) -> (&'static str, bool) {
    match kind {
        PortOptionKind::Usage(_) => ("usage", false),
        PortOptionKind::MessageFormat(_) => ("message_format", false),
        PortOptionKind::UserList(_) => ("user_list", true),
        PortOptionKind::TimeOut(_) => ("time_out", false),
        PortOptionKind::Class(_) => ("class", false),
        PortOptionKind::BoundedBuffer(_) => ("bounded_buffer", true),
        PortOptionKind::Retry(_) => ("retry", false),
        PortOptionKind::Resend(_) => ("resend", true),
        PortOptionKind::Penalty { .. } => ("penalty", true),
        PortOptionKind::Rate(_) => ("rate", false),
        PortOptionKind::Latest => ("latest", true),
    }
}
