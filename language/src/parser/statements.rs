//! The grammar of one-line statements, and of the heads of handlers and branches.

use super::expr::{Part, duration, expr, name, place, text, word};
use super::lines::{Line, places, ranks, takes};
use crate::ast::{BranchKind, Duration, Expr, Name, Place, StatementKind, Trigger, Verb};
use crate::lexer::Kind;
use crate::words::Word;
use chumsky::prelude::*;

/// The parsers of one-line statements and of the heads of handlers and branches, built once for each text.
pub(super) struct Statements<'t> {
    /// The parser of statements that begin with a keyword.
    pub command: Line<'t, StatementKind>,
    pub assignment: Line<'t, StatementKind>,
    pub trigger: Line<'t, Trigger>,
    pub branch: Line<'t, BranchKind>,
}

impl<'t> Statements<'t> {
    pub(super) fn new(source: &'t str) -> Self {
        let bare = |of, kind| word(of).to(kind);
        let order = word(Word::Order).ignore_then(ranks(source)).map(StatementKind::Order);
        let delay = word(Word::Delay).ignore_then(duration(source)).map(StatementKind::Delay);
        let start = word(Word::Start).ignore_then(name(source)).then(duration(source));
        let start = start.map(|(timer, length)| StatementKind::Start { timer, length });
        let stop = word(Word::Stop).ignore_then(name(source)).map(StatementKind::Stop);
        let abort =
            word(Word::Abort).ignore_then(text(source)).map(|(reason, _)| StatementKind::Abort(reason));
        let assert = word(Word::Assert).ignore_then(expr(source)).map(StatementKind::Assert);
        let assign = place(source).then_ignore(just(Kind::Assign)).then(expr(source));
        let assign = assign.map(|(place, value)| StatementKind::Assign { place, value });
        let of_time = choice((order.boxed(), delay.boxed(), start.boxed(), stop.boxed()));
        let plain = choice((abort.boxed(), assert.boxed(), bare(Word::Exit, StatementKind::Exit)));
        let command = choice((
            send(source).boxed(),
            receive(source).boxed(),
            reply(source).boxed(),
            waitfor(source).boxed(),
            run(source).boxed(),
            of_time.boxed(),
            plain.boxed(),
            bare(Word::Skip, StatementKind::Skip),
        ));
        Self {
            command: command.boxed(),
            assignment: assign.boxed(),
            trigger: trigger(source).boxed(),
            branch: branch().boxed(),
        }
    }
}

/// Parses expressions in parentheses.
fn arguments<'t>(source: &'t str) -> impl Part<'t, Vec<Expr>> {
    let list = expr(source).separated_by(just(Kind::Comma)).collect();
    list.delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose)).boxed()
}

/// Parses `within 3 msec`.
fn within<'t>(source: &'t str) -> impl Part<'t, Option<Duration>> {
    word(Word::Within).ignore_then(duration(source)).or_not().boxed()
}

/// Parses `-> a, b.c`.
fn into<'t>(source: &'t str) -> impl Part<'t, Vec<Place>> {
    just(Kind::Arrow).ignore_then(places(source)).or_not().map(Option::unwrap_or_default).boxed()
}

fn send<'t>(source: &'t str) -> impl Part<'t, StatementKind> {
    let verb = choice((
        word(Word::Send).to(Verb::Send),
        word(Word::UseSend).to(Verb::UseSend),
        word(Word::Query).to(Verb::Query),
    ));
    let line = verb.then(name(source)).then(arguments(source)).then(into(source)).then(within(source));
    line.map(|((((verb, port), arguments), into), within)| StatementKind::Send {
        verb,
        port,
        arguments,
        into,
        within,
    })
}

/// Parses places in parentheses.
fn targets<'t>(source: &'t str) -> impl Part<'t, Vec<Place>> {
    let list = place(source).separated_by(just(Kind::Comma)).collect();
    list.delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose))
}

fn receive<'t>(source: &'t str) -> impl Part<'t, StatementKind> {
    let from = word(Word::From).ignore_then(name(source)).or_not();
    let port = name(source).then(targets(source)).then(from);
    // `within` may also be the name of a port: then parentheses follow the word.
    let of_port = port.map(|((port, into), from)| (Some(port), into, from));
    let of_any = empty().to((None, Vec::new(), None::<Name>));
    let line = word(Word::Receive).ignore_then(of_port.or(of_any)).then(within(source));
    line.map(|((port, into, from), within)| StatementKind::Receive { port, into, from, within })
}

fn reply<'t>(source: &'t str) -> impl Part<'t, StatementKind> {
    let verb = word(Word::Reply).to(false).or(word(Word::Response).to(true));
    let ticket = word(Word::Ticket).ignore_then(expr(source)).or_not();
    let asker = word(Word::For).ignore_then(name(source)).then(ticket).or_not();
    let line = verb.then(name(source).or_not()).then(arguments(source)).then(asker);
    line.map(|(((response, port), arguments), asker)| {
        let (asker, ticket) = asker.unzip();
        StatementKind::Reply { response, port, arguments, asker, ticket: ticket.flatten() }
    })
}

fn waitfor<'t>(source: &'t str) -> impl Part<'t, StatementKind> {
    let line = word(Word::Waitfor).ignore_then(name(source)).then(arguments(source)).then(within(source));
    line.map(|((port, arguments), within)| StatementKind::Waitfor { port, arguments, within })
}

/// Parses `run`. The arguments of the action stand alone, `run weld p.spot, 3`, or in parentheses, `run weld(p.spot, 3)`.
fn run<'t>(source: &'t str) -> impl Part<'t, StatementKind> {
    let list = expr(source).separated_by(just(Kind::Comma));
    let several = list.clone().at_least(2).collect::<Vec<_>>();
    let in_parentheses = choice((several, empty().map(|()| Vec::new())))
        .delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose));
    let bare = list.collect::<Vec<_>>();
    let range = expr(source).then_ignore(just(Kind::DotDot)).then(expr(source));
    let line = word(Word::Run)
        .ignore_then(name(source))
        .then(in_parentheses.or(bare))
        .then(into(source))
        .then(word(Word::In).ignore_then(range).or_not())
        .then(takes(source).or_not());
    line.map(|((((action, arguments), into), range), takes)| StatementKind::Run {
        action,
        arguments,
        into,
        range,
        takes,
    })
}

/// Parses the trigger of a handler, between `on` and `do`.
fn trigger<'t>(source: &'t str) -> impl Part<'t, Trigger> {
    let variables = name(source).separated_by(just(Kind::Comma)).collect();
    let variables = variables.delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose));
    let query = word(Word::Query).to(true).or(word(Word::Receive).to(false));
    let message = query
        .then(name(source))
        .then(variables)
        .map(|((query, port), variables)| Trigger::Message { query, port, variables });
    let when = word(Word::When).ignore_then(expr(source)).or_not();
    let silence = word(Word::Silence).ignore_then(name(source)).then(duration(source)).then(when);
    let silence = silence.map(|((port, length), when)| Trigger::Silence { port, length, when });
    let expiry = word(Word::Expiry).ignore_then(name(source)).map(Trigger::Expiry);
    let fence = word(Word::Fence).to(Trigger::Fence);
    choice((message.boxed(), silence.boxed(), expiry.boxed(), fence))
}

/// Parses the kind of a branch, between `on` and `do`.
fn branch<'t>() -> impl Part<'t, BranchKind> {
    choice((
        word(Word::TimeOut).to(BranchKind::TimeOut),
        word(Word::Refused).to(BranchKind::Refused),
        word(Word::Failed).to(BranchKind::Failed),
    ))
}
