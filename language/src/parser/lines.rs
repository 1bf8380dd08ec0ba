//! The grammar, line by line: the part between one `;`, `do` or `then` and the next.

use super::expr::{
    Part, duration, durations, expr, name, name_or_self, number, place, rate, sign, text, word,
};
use super::failure::{FAULT, OPTION, TYPE, USAGE};
use super::{Extra, Tokens};
use crate::ast::{
    CheckDecl, CheckKind, CoupleDecl, CoupleKind, Expr, Fault, FaultsDecl, Field, Item, LinkDecl, Name,
    NodeDecl, Place, PortOption, PortOptionKind, Rate, TickDecl, TypeName, VarDecl,
};
use crate::lexer::Kind;
use crate::span::Span;
use crate::words::Word;
use chumsky::Boxed;
use chumsky::prelude::*;
use imrs_protocol::Usage;
use imrs_protocol::script::Type;

/// A parser for one kind of line.
pub(super) type Line<'t, O> = Boxed<'t, 't, Tokens<'t>, O, Extra>;

/// The head of a port: its name, its parameters, the type of its answer.
pub(super) type PortHead = (Name, Vec<Field>, Option<TypeName>);

/// The head of a task.
pub(super) struct TaskHead {
    pub name: Name,
    pub on: Name,
    pub module: Option<Name>,
    pub standby_of: Option<Name>,
    pub is_extern: Option<Span>,
    pub rate: Option<Rate>,
}

/// The parsers of all lines that are no statements, built once for each text.
pub(super) struct Lines<'t> {
    pub cell: Line<'t, Name>,
    pub item: Line<'t, Item>,
    pub type_head: Line<'t, Name>,
    pub fields: Line<'t, Vec<Field>>,
    pub task_head: Line<'t, TaskHead>,
    pub port_head: Line<'t, PortHead>,
    pub option: Line<'t, PortOption>,
    pub variables: Line<'t, VarDecl>,
    pub condition: Line<'t, Expr>,
}

impl<'t> Lines<'t> {
    pub(super) fn new(source: &'t str) -> Self {
        Self {
            cell: word(Word::Cell).ignore_then(name(source)).boxed(),
            item: item(source).boxed(),
            type_head: type_head(source).boxed(),
            fields: fields(source).boxed(),
            task_head: task_head(source).boxed(),
            port_head: port_head(source).boxed(),
            option: option(source).boxed(),
            variables: variables(source).boxed(),
            condition: expr(source).boxed(),
        }
    }
}

/// Parses a declaration that takes one line.
fn item<'t>(source: &'t str) -> impl Part<'t, Item> {
    let tick = word(Word::Model).or_not().then_ignore(word(Word::Tick)).then(duration(source));
    let tick = tick.map_with(|(model, length), extra| {
        Item::Tick(TickDecl { model: model.is_some(), length, span: extra.span() })
    });
    let ends = name(source).then_ignore(just(Kind::Link)).then(name(source));
    let capacity = word(Word::Capacity).ignore_then(just(Kind::Equal)).ignore_then(rate(source)).or_not();
    let link = word(Word::Link).ignore_then(ends).then_ignore(word(Word::Delay));
    let link = link.then(duration(source)).then(capacity).map_with(|(((a, b), delay), capacity), extra| {
        Item::Link(LinkDecl { a, b, delay, capacity, span: extra.span() })
    });
    let at = word(Word::At).ignore_then(text(source)).or_not();
    let port = word(Word::Port).ignore_then(number(source)).or_not();
    let node = word(Word::Node).ignore_then(name(source)).then(at).then(port);
    let node = node
        .map_with(|((name, at), port), extra| Item::Node(NodeDecl { name, at, port, span: extra.span() }));
    choice((
        tick.boxed(),
        link.boxed(),
        node.boxed(),
        couple(source).boxed(),
        faults(source).boxed(),
        check(source),
    ))
}

/// Parses a list of names in braces.
fn set<'t>(source: &'t str) -> impl Part<'t, Vec<Name>> {
    let names = name(source).separated_by(just(Kind::Comma)).at_least(1).collect();
    names.delimited_by(just(Kind::BraceOpen), just(Kind::BraceClose)).boxed()
}

fn couple<'t>(source: &'t str) -> impl Part<'t, Item> {
    let loose = word(Word::Loose).ignore_then(set(source)).then_ignore(word(Word::Over)).then(name(source));
    let loose = loose.map(|(tasks, over)| CoupleKind::Loose { tasks, over });
    let tight = word(Word::Tight).ignore_then(set(source)).map(CoupleKind::Tight);
    let serial =
        word(Word::Serial).ignore_then(name(source)).then_ignore(just(Kind::Arrow)).then(name(source));
    let serial = serial.map(|(first, then)| CoupleKind::Serial(first, then));
    let way = choice((just(Kind::Arrow).to(false), just(Kind::BothWays).to(true)));
    let work = word(Word::Work)
        .ignore_then(name(source))
        .then(way)
        .then(name(source))
        .then(word(Word::Lease).ignore_then(duration(source)))
        .then(word(Word::Takeover).ignore_then(duration(source)))
        .then(word(Word::Every).ignore_then(duration(source)))
        .then(word(Word::Via).ignore_then(name(source)));
    let work = work.map(|((((((primary, mutual), standby), lease), takeover), every), via)| {
        CoupleKind::Work { primary, standby, mutual, lease, takeover, every, via }
    });
    let kind = choice((loose.boxed(), tight.boxed(), serial.boxed(), work.boxed()));
    word(Word::Couple)
        .ignore_then(kind)
        .map_with(|kind, extra| Item::Couple(CoupleDecl { kind, span: extra.span() }))
}

fn faults<'t>(source: &'t str) -> impl Part<'t, Item> {
    let count = |of, fault: fn(_) -> Fault| word(of).ignore_then(number(source)).map(fault);
    let crash = word(Word::Crash).ignore_then(name(source)).map(Fault::Crash);
    let most = word(Word::Up).ignore_then(word(Word::To)).ignore_then(duration(source));
    let pause = word(Word::Pause).ignore_then(name(source)).then(most.or_not());
    let pause = pause.map(|(of, most)| Fault::Pause(of, most));
    let ends = name(source).then_ignore(just(Kind::Link)).then(name(source));
    let cut = word(Word::Cut).ignore_then(ends).map(|(a, b)| Fault::Cut(a, b));
    let fault = choice((
        count(Word::Loss, Fault::Loss),
        count(Word::Dup, Fault::Dup),
        count(Word::Fail, Fault::Fail),
        count(Word::Drift, Fault::Drift),
        crash,
        pause,
        cut,
    ))
    .labelled(FAULT);
    let faults = word(Word::Faults).ignore_then(fault.repeated().at_least(1).collect());
    faults.map_with(|faults, extra| Item::Faults(FaultsDecl { faults, span: extra.span() }))
}

fn check<'t>(source: &'t str) -> impl Part<'t, Item> {
    let never = word(Word::Never).ignore_then(expr(source)).map(CheckKind::Never);
    let always = word(Word::Always).ignore_then(expr(source)).map(CheckKind::Always);
    let then = word(Word::Leads).ignore_then(expr(source));
    let within = word(Word::Within).ignore_then(duration(source));
    let leads = expr(source).then(then.then(within).or_not()).map(|(when, rest)| match rest {
        Some((then, within)) => CheckKind::Leads { when, then, within },
        None => CheckKind::Always(when),
    });
    let kind = choice((never.boxed(), always.boxed(), leads.boxed()));
    let check = word(Word::Check).ignore_then(name(source)).then_ignore(just(Kind::Colon)).then(kind);
    check.map_with(|(name, kind), extra| Item::Check(CheckDecl { name, kind, span: extra.span() }))
}

fn type_head<'t>(source: &'t str) -> impl Part<'t, Name> {
    let is_record = word(Word::Is).then(word(Word::Record));
    word(Word::Type).ignore_then(name(source)).then_ignore(is_record)
}

/// Parses the name of a type.
fn type_name<'t>(source: &'t str) -> impl Part<'t, TypeName> {
    let plain = |of, is| word(of).map(move |span| TypeName::Plain(is, span));
    let plain = choice((
        plain(Word::Bool, Type::Bool),
        plain(Word::Int8, Type::Int8),
        plain(Word::Int16, Type::Int16),
        plain(Word::Int32, Type::Int32),
        plain(Word::Integer, Type::Int32),
        plain(Word::Word, Type::Word),
        plain(Word::Real, Type::Real),
    ));
    let timer = word(Word::Timer).map(TypeName::Timer);
    choice((plain.boxed(), timer, name(source).map(TypeName::Record))).labelled(TYPE).boxed()
}

/// Parses `speed: real`; Figure 1 has a field without the colon.
fn fields<'t>(source: &'t str) -> impl Part<'t, Vec<Field>> {
    let names = name(source).separated_by(just(Kind::Comma)).at_least(1).collect::<Vec<_>>();
    names
        .then_ignore(just(Kind::Colon).or_not())
        .then(type_name(source))
        .map(|(names, of)| names.into_iter().map(|name| Field { name, of: Some(of.clone()) }).collect())
}

fn task_head<'t>(source: &'t str) -> impl Part<'t, TaskHead> {
    let rate = word(Word::Rate).then(just(Kind::Equal)).ignore_then(rate(source));
    word(Word::Task)
        .ignore_then(name(source))
        .then(word(Word::On).ignore_then(name(source)))
        .then(word(Word::Module).ignore_then(name(source)).or_not())
        .then(word(Word::Standby).then(word(Word::Of)).ignore_then(name(source)).or_not())
        .then(word(Word::Extern).then(rate.or_not()).or_not())
        .map(|((((name, on), module), standby_of), is_extern)| {
            let (is_extern, rate) = is_extern.map_or((None, None), |(span, rate)| (Some(span), rate));
            TaskHead { name, on, module, standby_of, is_extern, rate }
        })
}

fn port_head<'t>(source: &'t str) -> impl Part<'t, PortHead> {
    let of = sign(Kind::Colon).ignore_then(type_name(source)).or_not();
    let parameter = name(source).then(of).map(|(name, of)| Field { name, of });
    let parameters = parameter.separated_by(just(Kind::Comma)).collect();
    let parameters = parameters.delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose));
    let answer = just(Kind::Arrow).ignore_then(type_name(source)).or_not();
    let kind = word(Word::Port).or(word(Word::UsePort));
    let head = kind.ignore_then(name(source)).then(parameters).then(answer);
    head.map(|((name, parameters), answer)| (name, parameters, answer))
}

fn option<'t>(source: &'t str) -> impl Part<'t, PortOption> {
    let valued = |of| word(of).then(just(Kind::Equal)).ignored();
    let usage = valued(Word::Usage).ignore_then(usage()).map(PortOptionKind::Usage);
    let format = valued(Word::MessageFormat).ignore_then(name(source)).map(PortOptionKind::MessageFormat);
    let users = valued(Word::UserList).ignore_then(users(source)).map(PortOptionKind::UserList);
    let time_out = valued(Word::TimeOut).ignore_then(duration(source)).map(PortOptionKind::TimeOut);
    let class = valued(Word::Class).ignore_then(number(source)).map(PortOptionKind::Class);
    let size = number(source).delimited_by(just(Kind::BracketOpen), just(Kind::BracketClose));
    let buffer = word(Word::BoundedBuffer).ignore_then(size).map(PortOptionKind::BoundedBuffer);
    let retry = valued(Word::Retry).ignore_then(number(source)).map(PortOptionKind::Retry);
    let resend = valued(Word::Resend).ignore_then(duration(source)).map(PortOptionKind::Resend);
    let penalty = valued(Word::Penalty).ignore_then(word(Word::Paper).or_not()).then(duration(source));
    let penalty = penalty.map(|(paper, length)| PortOptionKind::Penalty { literal: paper.is_some(), length });
    let rate = valued(Word::Rate).ignore_then(rate(source)).map(PortOptionKind::Rate);
    let latest = word(Word::Latest).to(PortOptionKind::Latest);
    let early = choice((usage.boxed(), format.boxed(), users.boxed(), time_out.boxed(), class.boxed()));
    let late = choice((
        buffer.boxed(),
        retry.boxed(),
        resend.boxed(),
        penalty.boxed(),
        rate.boxed(),
        latest.boxed(),
    ));
    early.or(late).labelled(OPTION).map_with(|kind, extra| PortOption { kind, span: extra.span() })
}

fn usage<'t>() -> impl Part<'t, Usage> {
    choice((
        word(Word::Send).to(Usage::Send),
        word(Word::Receive).to(Usage::Receive),
        word(Word::Reply).to(Usage::Reply),
        word(Word::Query).to(Usage::Query),
        word(Word::Response).to(Usage::Response),
        word(Word::Waitfor).to(Usage::Waitfor),
    ))
    .labelled(USAGE)
}

/// Parses `{a, b}` and `(a b)`: Figure 1 has parentheses and no commas, the text of §3 has braces and commas (D10).
fn users<'t>(source: &'t str) -> impl Part<'t, Vec<Name>> {
    let names =
        name(source).then_ignore(just(Kind::Comma).or_not()).repeated().at_least(1).collect::<Vec<_>>();
    let braces = names.clone().delimited_by(just(Kind::BraceOpen), just(Kind::BraceClose));
    braces.or(names.delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose)))
}

fn variables<'t>(source: &'t str) -> impl Part<'t, VarDecl> {
    let names = name(source).separated_by(just(Kind::Comma)).at_least(1).collect();
    let line = word(Word::Var).ignore_then(names).then_ignore(just(Kind::Colon)).then(type_name(source));
    line.map_with(|(names, of), extra| VarDecl { names, of, span: extra.span() })
}

/// Parses places, separated by commas.
pub(super) fn places<'t>(source: &'t str) -> impl Part<'t, Vec<Place>> {
    place(source).separated_by(just(Kind::Comma)).at_least(1).collect().boxed()
}

/// Parses the entries of an `order`, separated by `>`.
pub(super) fn ranks<'t>(source: &'t str) -> impl Part<'t, Vec<Name>> {
    name_or_self(source).separated_by(just(Kind::Greater)).at_least(1).collect()
}

/// Parses `1..4 sec`.
pub(super) fn takes<'t>(source: &'t str) -> impl Part<'t, (crate::ast::Duration, crate::ast::Duration)> {
    word(Word::Takes).ignore_then(durations(source))
}
