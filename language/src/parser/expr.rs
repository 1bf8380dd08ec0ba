//! The grammar of names, numbers, durations and expressions.

use super::failure::{EXPRESSION, Failure, NAME};
use super::{Extra, Tokens};
use crate::ast::{Duration, Expr, ExprKind, Name, Number, Place, Rate};
use crate::codes::{NUMBER, UNCLEAR_NOT, UNIT};
use crate::diagnostic::Diagnostic;
use crate::lexer::Kind;
use crate::span::Span;
use crate::words::Word;
use chumsky::prelude::*;
use imrs_protocol::script::Binary;

/// A parser for a part of the grammar. A part that many others use is boxed: otherwise their types would contain its
/// type, and would take longer to compile.
pub(super) trait Part<'t, O>: Parser<'t, Tokens<'t>, O, Extra> + Clone + 't {}
impl<'t, O, P: Parser<'t, Tokens<'t>, O, Extra> + Clone + 't> Part<'t, O> for P {}

/// Parses the keyword `word`.
pub(super) fn word<'t>(word: Word) -> impl Part<'t, Span> {
    just(Kind::Word(word)).map_with(|_, extra| extra.span()).boxed()
}

/// Parses the token `kind`.
pub(super) fn sign<'t>(kind: Kind) -> impl Part<'t, Span> {
    just(kind).map_with(|_, extra| extra.span())
}

/// Parses a name.
pub(super) fn name<'t>(text: &'t str) -> impl Part<'t, Name> {
    any()
        .filter(|kind| match kind {
            Kind::Name => true,
            Kind::Word(word) => !word.is_reserved(),
            _ => false,
        })
        .map_with(move |_, extra| {
            let span: Span = extra.span();
            Name { text: text[span.range()].to_owned(), span }
        })
        .labelled(NAME)
        .boxed()
}

/// Parses an entry of an `order`: a name, `self`, or `timer` for all timers of the task.
pub(super) fn name_or_self<'t>(text: &'t str) -> impl Part<'t, Name> {
    let myself = word(Word::Myself).map(|span| Name { text: "self".to_owned(), span });
    let timers = word(Word::Timer).map(|span| Name { text: "timer".to_owned(), span });
    choice((myself, timers, name(text))).labelled("a name, `self` or `timer`")
}

/// Parses a whole number.
pub(super) fn number<'t>(text: &'t str) -> impl Part<'t, Number> {
    just(Kind::Int)
        .validate(move |_, extra, emitter| {
            let span: Span = extra.span();
            let value = digits(&text[span.range()]).parse().unwrap_or_else(|_| {
                emitter.emit(too_large(span, u32::MAX.into()));
                0
            });
            Number { value, span }
        })
        .labelled("a number")
        .boxed()
}

/// Removes the `_` between groups of digits.
fn digits(text: &str) -> String {
    text.replace('_', "")
}

fn too_large(span: Span, most: u64) -> Failure {
    let found = Diagnostic::error(NUMBER, span, format!("this number is larger than {most}"))
        .help(format!("write a number up to {most}"));
    Failure::Said(Box::new(found))
}

/// Parses a number, with or without a fraction. Gives its span.
fn amount<'t>() -> impl Part<'t, Span> {
    choice((sign(Kind::Int), sign(Kind::Real))).labelled("a number").boxed()
}

/// Parses a unit of time. Gives its length in microseconds.
fn unit<'t>(text: &'t str) -> impl Part<'t, u64> {
    let known = choice(Word::UNITS.iter().map(|(unit, usec)| word(*unit).to(*usec)).collect::<Vec<_>>());
    let unknown = just(Kind::Name).validate(move |_, extra, emitter| {
        let span: Span = extra.span();
        emitter.emit(Failure::Said(Box::new(unknown_unit(&text[span.range()], span))));
        1
    });
    known.or(unknown).labelled("a unit (`usec`, `msec`, `sec`)").boxed()
}

fn unknown_unit(text: &str, span: Span) -> Diagnostic {
    let shown = super::failure::clip(text);
    let found = Diagnostic::error(UNIT, span, format!("`{shown}` is not a unit of time"));
    let meant = match text.to_ascii_lowercase().as_str() {
        "us" | "micros" | "microseconds" => Some(Word::Usec),
        "ms" | "millis" | "milliseconds" | "millisec" => Some(Word::Msec),
        "s" | "second" | "seconds" => Some(Word::Sec),
        _ => Word::near(text, &[Word::Usec, Word::Msec, Word::Sec]),
    };
    match meant {
        Some(unit) => found.help(format!("did you mean `{}`?", unit.text())),
        None => found.help("the units are `usec`, `msec` and `sec`"),
    }
}

/// Parses `20 msec`.
pub(super) fn duration<'t>(text: &'t str) -> impl Part<'t, Duration> {
    let duration = amount().then(unit(text)).validate(move |(number, usec), extra, emitter| {
        let span: Span = extra.span();
        length(&text[number.range()], usec, span).unwrap_or_else(|found| {
            emitter.emit(Failure::Said(found));
            Duration { usec: 0, span }
        })
    });
    duration.boxed()
}

/// Parses `1..4 sec`, `200 msec..1 sec`; `5 msec` stands for `5..5 msec`.
pub(super) fn durations<'t>(text: &'t str) -> impl Part<'t, (Duration, Duration)> {
    let least = amount().then(unit(text).or_not());
    let most = sign(Kind::DotDot).ignore_then(amount().then(unit(text)));
    let range =
        least.clone().then(most).map(|((a, unit), (b, of_both))| (a, unit.unwrap_or(of_both), b, of_both));
    let single = amount().then(unit(text)).map(|(a, unit)| (a, unit, a, unit));
    range.or(single).validate(move |(a, unit_a, b, unit_b), _, emitter| {
        let mut one = |number: Span, unit| {
            length(&text[number.range()], unit, number).unwrap_or_else(|found| {
                emitter.emit(Failure::Said(found));
                Duration { usec: 0, span: number }
            })
        };
        (one(a, unit_a), one(b, unit_b))
    })
}

/// The duration of `number` times `unit` microseconds.
fn length(number: &str, unit: u64, span: Span) -> Result<Duration, Box<Diagnostic>> {
    let number = digits(number);
    let wrong = |message: &str| Diagnostic::error(NUMBER, span, message);
    let too_long =
        || Box::new(wrong("this time is too long").help("write a shorter one: years are never waited for"));
    if let Ok(whole) = number.parse::<u64>() {
        let usec = whole.checked_mul(unit).ok_or_else(too_long)?;
        return Ok(Duration { usec, span });
    }
    // Below 2^53 microseconds, 285 years, a double is exact.
    let usec = number.parse::<f64>().unwrap_or(f64::INFINITY) * unit as f64;
    if usec >= (1_u64 << 53) as f64 {
        return Err(too_long());
    }
    if (usec - usec.round()).abs() > 1e-6 {
        let found = wrong("a time is a whole number of microseconds").help("write it in `usec`");
        return Err(Box::new(found));
    }
    Ok(Duration { usec: usec.round() as u64, span })
}

/// Parses `20/1 sec`.
pub(super) fn rate<'t>(text: &'t str) -> impl Part<'t, Rate> {
    number(text).then_ignore(just(Kind::Slash)).then(duration(text)).map(|(count, per)| Rate { count, per })
}

/// Parses a text in quotes. Gives the text without the quotes.
pub(super) fn text<'t>(text: &'t str) -> impl Part<'t, (String, Span)> {
    just(Kind::Text)
        .map_with(move |_, extra| {
            let span: Span = extra.span();
            let inner = text[span.range()].trim_matches(|c| c == '"' || c == '\'');
            (inner.to_owned(), span)
        })
        .labelled("a text in quotes")
}

/// Parses `me.height`.
pub(super) fn place<'t>(text: &'t str) -> impl Part<'t, Place> {
    name(text)
        .separated_by(just(Kind::Dot))
        .at_least(1)
        .collect()
        .map_with(|path, extra| Place { path, span: extra.span() })
        .boxed()
}

/// Parses an expression: `or` binds least, then `and`, `not`, comparisons, sums, products, signs.
pub(super) fn expr<'t>(text: &'t str) -> impl Part<'t, Expr> {
    recursive(|expr| {
        let inner = expr.clone().delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose));
        let trunc = word(Word::Trunc).then(inner.clone());
        let trunc = trunc.map_with(|(_, of): (Span, Expr), extra| Expr {
            kind: ExprKind::Trunc(of.into()),
            span: extra.span(),
        });
        let in_parentheses = inner.map_with(|expr: Expr, extra| Expr { span: extra.span(), ..expr });
        let operand = choice((literal(text), trunc, path_or_call(text), in_parentheses)).boxed();
        let minus = sign(Kind::Minus).repeated();
        let signed = minus.foldr(operand, |minus, of: Expr| Expr {
            span: minus.to(of.span),
            kind: ExprKind::Negate(Box::new(of)),
        });
        let times = choice((
            just(Kind::Times).to(Binary::Multiply),
            just(Kind::Slash).to(Binary::Divide),
            just(Kind::Word(Word::Mod)).to(Binary::Remainder),
        ));
        let product = chain(signed.labelled("a value").boxed(), times).boxed();
        let plus = choice((just(Kind::Plus).to(Binary::Add), just(Kind::Minus).to(Binary::Subtract)));
        let sum = chain(product, plus).boxed();
        let negated = negated(comparison(sum)).boxed();
        let both = chain(negated, just(Kind::Word(Word::And)).to(Binary::And)).boxed();
        chain(both, just(Kind::Word(Word::Or)).to(Binary::Or)).boxed().labelled(EXPRESSION)
    })
    .boxed()
}

/// Parses a left-associative chain: `a + b + c`.
fn chain<'t>(of: impl Part<'t, Expr>, operator: impl Part<'t, Binary>) -> impl Part<'t, Expr> {
    let more = operator.labelled("an operator").then(of.clone()).repeated();
    of.foldl(more, binary_of)
}

fn binary_of(left: Expr, (operator, right): (Binary, Expr)) -> Expr {
    let span = left.span.to(right.span);
    Expr { kind: ExprKind::Binary(operator, Box::new(left), Box::new(right)), span }
}

/// Parses a sum, or a comparison of two sums. The flag says whether it is a comparison.
fn comparison<'t>(sum: impl Part<'t, Expr>) -> impl Part<'t, (Expr, bool)> {
    let operator = choice((
        just(Kind::Equal).to(Binary::Equal),
        just(Kind::NotEqual).to(Binary::NotEqual),
        just(Kind::Less).to(Binary::Less),
        just(Kind::LessOrEqual).to(Binary::LessOrEqual),
        just(Kind::Greater).to(Binary::Greater),
        just(Kind::GreaterOrEqual).to(Binary::GreaterOrEqual),
    ));
    let rest = operator.labelled("an operator").then(sum.clone()).or_not();
    sum.then(rest).map(|(left, rest)| match rest {
        Some(rest) => (binary_of(left, rest), true),
        None => (left, false),
    })
}

/// Parses `not not a`. Structured Text and RAPID read `not a = b` differently, so this needs parentheses.
fn negated<'t>(of: impl Part<'t, (Expr, bool)>) -> impl Part<'t, Expr> {
    let nots = word(Word::Not).repeated().collect::<Vec<_>>();
    nots.then(of).validate(|(nots, (of, compares)), _, emitter| {
        if let (Some(not), true) = (nots.last(), compares) {
            emitter.emit(Failure::Said(Box::new(unclear_not(*not, of.span))));
        }
        nots.into_iter()
            .rev()
            .fold(of, |of, not: Span| Expr { span: not.to(of.span), kind: ExprKind::Not(Box::new(of)) })
    })
}

fn unclear_not(not: Span, compared: Span) -> Diagnostic {
    Diagnostic::error(UNCLEAR_NOT, not, "it is not plain what this `not` covers")
        .also(compared, "all of this, or its first operand?")
        .help("write `not (a = b)` or `(not a) = b`")
}

fn literal<'t>(text: &'t str) -> impl Part<'t, Expr> {
    let int = just(Kind::Int).validate(move |_, extra, emitter| {
        let span: Span = extra.span();
        let value = digits(&text[span.range()]).parse().unwrap_or_else(|_| {
            emitter.emit(too_large(span, i64::MAX as u64));
            0
        });
        Expr { kind: ExprKind::Int(value), span }
    });
    let real = just(Kind::Real).validate(move |_, extra, emitter| {
        let span: Span = extra.span();
        let number = digits(&text[span.range()]);
        if !number.parse::<f32>().is_ok_and(f32::is_finite) {
            let found = Diagnostic::error(NUMBER, span, "this number is too large for a `real`")
                .help("write a smaller number: at most 3.4e38");
            emitter.emit(Failure::Said(Box::new(found)));
        }
        Expr { kind: ExprKind::Real(number), span }
    });
    let truth = |of, value| word(of).map(move |span| Expr { kind: ExprKind::Bool(value), span });
    choice((int, real, truth(Word::True, true), truth(Word::False, false)))
}

fn path_or_call<'t>(text: &'t str) -> impl Part<'t, Expr> {
    let argument = name(text).delimited_by(just(Kind::ParenOpen), just(Kind::ParenClose));
    place(text).then(argument.or_not()).map_with(|(of, argument), extra| {
        let kind = match argument {
            Some(argument) => ExprKind::Call { of, argument },
            None => ExprKind::Path(of),
        };
        Expr { kind, span: extra.span() }
    })
}
