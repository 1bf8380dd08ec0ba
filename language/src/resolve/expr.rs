//! Types expressions and folds constants.
//!
//! Integers of all sizes mix. An integer becomes a real where a real is wanted, never the other way. Constants are folded
//! here, so that the compiler reports a constant that does not fit, before anything runs.

use super::TYPES;
use crate::ast::{Expr as Written, ExprKind, Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::Expr;
use crate::span::Span;
use imrs_protocol::script::{Binary, Op, ScriptFault, Term, Type, eval, real};

/// A typed expression, and its value if the expression is constant.
#[derive(Clone, Debug)]
pub(super) struct Typed {
    pub of: Type,
    pub ops: Vec<Op>,
    pub constant: Option<i64>,
    pub span: Span,
}

impl Typed {
    pub fn constant(of: Type, value: i64, span: Span) -> Self {
        Self { of, ops: vec![Op::Term(Term::Push(value))], constant: Some(value), span }
    }

    pub fn new(of: Type, ops: Vec<Op>, span: Span) -> Self {
        Self { of, ops, constant: None, span }
    }

    pub fn finish(self) -> Expr {
        Expr { of: self.of, ops: self.ops, span: self.span }
    }
}

/// What differs between the expressions of tasks and the expressions of checks: which names they may use, and where
/// diagnostics go.
pub(super) trait Leaves {
    fn report(&mut self, found: Diagnostic);
    /// Types a variable, or a keyword that stands for a value.
    fn place(&mut self, place: &Place) -> Option<Typed>;
    /// Types `lift.arrived(armR)`.
    fn call(&mut self, of: &Place, argument: &Name, span: Span) -> Option<Typed>;
    /// Types a comparison with a keyword on one side: `outcome = refused`, `sender = armL`, `received = halt`. `None` if
    /// neither side is such a keyword.
    fn compared(&mut self, a: &Written, b: &Written, span: Span) -> Option<Option<Typed>>;
}

/// The type and the operations of an expression; `None` if an error was reported.
pub(super) fn typed(leaves: &mut impl Leaves, written: &Written) -> Option<Typed> {
    // The tree of a chain `a + b + c ..` is as deep as the chain is long, so a loop goes through it, not by recursion.
    let mut chain = Vec::new();
    let mut first = written;
    while let ExprKind::Binary(operator, a, b) = &first.kind {
        if is_equality(*operator)
            && let Some(value) = leaves.compared(a, b, first.span)
        {
            let value = value.map(|value| negated_if(*operator == Binary::NotEqual, value));
            return chain_up(leaves, value, &chain);
        }
        chain.push((*operator, &**b, first.span));
        first = a;
    }
    let value = operand(leaves, first);
    chain_up(leaves, value, &chain)
}

fn chain_up(
    leaves: &mut impl Leaves,
    first: Option<Typed>,
    chain: &[(Binary, &Written, Span)],
) -> Option<Typed> {
    let mut value = first;
    for &(operator, b, span) in chain.iter().rev() {
        let b = typed(leaves, b);
        value = match (value, b) {
            (Some(a), Some(b)) => binary(leaves, operator, a, b, span),
            _ => None,
        };
    }
    value
}

const fn is_equality(operator: Binary) -> bool {
    matches!(operator, Binary::Equal | Binary::NotEqual)
}

fn negated_if(negated: bool, mut value: Typed) -> Typed {
    if negated {
        value.ops.push(Op::Term(Term::Not));
    }
    value
}

fn operand(leaves: &mut impl Leaves, written: &Written) -> Option<Typed> {
    let span = written.span;
    match &written.kind {
        ExprKind::Bool(value) => Some(Typed::constant(Type::Bool, i64::from(*value), span)),
        ExprKind::Int(value) => Some(Typed::constant(Type::Int32, *value, span)),
        ExprKind::Real(text) => match text.parse::<f32>().ok().and_then(real) {
            Some(value) => Some(Typed::constant(Type::Real, value, span)),
            None => {
                leaves.report(
                    Diagnostic::error(TYPES, span, format!("{text} is too large for a real"))
                        .label("at most 3.4E38")
                        .help("write a smaller number"),
                );
                None
            }
        },
        ExprKind::Path(place) => leaves.place(place),
        ExprKind::Call { of, argument } => leaves.call(of, argument, span),
        ExprKind::Not(inner) => {
            let inner = typed(leaves, inner)?;
            let inner = truth(leaves, inner, "`not`")?;
            Some(unary(Term::Not, Type::Bool, inner, span))
        }
        ExprKind::Negate(inner) => {
            let inner = typed(leaves, inner)?;
            match inner.of {
                Type::Bool => {
                    leaves.report(mismatch("`-` of a bool", inner.span, "a bool").help("write `not`"));
                    None
                }
                Type::Real => Some(unary(Term::NegateReal, Type::Real, inner, span)),
                Type::Int8 | Type::Int16 | Type::Int32 | Type::Word => {
                    Some(unary(Term::Negate, Type::Int32, inner, span))
                }
            }
        }
        ExprKind::Trunc(inner) => {
            let inner = typed(leaves, inner)?;
            if inner.of == Type::Real {
                return truncated(leaves, inner, span);
            }
            let label = if inner.of == Type::Bool { "a bool" } else { "whole already" };
            leaves.report(mismatch("`trunc` wants a real", inner.span, label).help("write the value itself"));
            None
        }
        ExprKind::Binary(..) => typed(leaves, written),
    }
}

/// The whole part of a real.
fn truncated(leaves: &mut impl Leaves, inner: Typed, span: Span) -> Option<Typed> {
    let whole = unary(Term::ToInt, Type::Int32, inner, span);
    if whole.constant.is_some_and(|value| !Type::Int32.holds(value)) {
        leaves.report(
            Diagnostic::error(TYPES, span, "the whole part is too large for an int32")
                .label("always")
                .help("divide it first"),
        );
        return None;
    }
    Some(whole)
}

fn unary(term: Term, of: Type, inner: Typed, span: Span) -> Typed {
    if let Some(value) = inner.constant
        && let Ok(value) = eval(&[Term::Push(value), term], |_| None)
    {
        return Typed::constant(of, value, span);
    }
    let mut ops = inner.ops;
    ops.push(Op::Term(term));
    Typed::new(of, ops, span)
}

fn binary(leaves: &mut impl Leaves, operator: Binary, a: Typed, b: Typed, span: Span) -> Option<Typed> {
    let (is_bool, is_real) = (a.of == Type::Bool, a.of == Type::Real || b.of == Type::Real);
    let sign = sign(operator);
    let (a, b, term, of) = match operator {
        Binary::And | Binary::Or => {
            let (a, b) = (truth(leaves, a, sign), truth(leaves, b, sign));
            (a?, b?, Term::Int(operator), Type::Bool)
        }
        Binary::Equal | Binary::NotEqual if is_bool && b.of == Type::Bool => {
            (a, b, Term::Int(operator), Type::Bool)
        }
        Binary::Add
        | Binary::Subtract
        | Binary::Multiply
        | Binary::Divide
        | Binary::Remainder
        | Binary::Equal
        | Binary::NotEqual
        | Binary::Less
        | Binary::LessOrEqual
        | Binary::Greater
        | Binary::GreaterOrEqual => {
            if let Some(odd) = [&a, &b].into_iter().find(|value| value.of == Type::Bool) {
                let found = mismatch(&format!("{sign} of a bool"), odd.span, "a bool, not a number")
                    .help("bools are joined with `and`, `or` and `not`, and compared with `=` and `<>`");
                leaves.report(found);
                return None;
            }
            if is_real && operator == Binary::Remainder {
                leaves.report(
                    mismatch("`mod` of reals", span, "only integers have a remainder")
                        .help("cut them off: `trunc(a) mod trunc(b)`"),
                );
                return None;
            }
            let of = match operator {
                Binary::Add | Binary::Subtract | Binary::Multiply | Binary::Divide | Binary::Remainder => {
                    if is_real {
                        Type::Real
                    } else {
                        Type::Int32
                    }
                }
                Binary::Equal
                | Binary::NotEqual
                | Binary::Less
                | Binary::LessOrEqual
                | Binary::Greater
                | Binary::GreaterOrEqual
                | Binary::And
                | Binary::Or => Type::Bool,
            };
            if is_real {
                (to_real(a), to_real(b), Term::Real(operator), of)
            } else {
                (a, b, Term::Int(operator), of)
            }
        }
    };
    fold(leaves, term, of, a, b, span)
}

fn fold(leaves: &mut impl Leaves, term: Term, of: Type, a: Typed, b: Typed, span: Span) -> Option<Typed> {
    if let (Some(x), Some(y)) = (a.constant, b.constant) {
        let why = match eval(&[Term::Push(x), Term::Push(y), term], |_| None) {
            Ok(value) => return Some(Typed::constant(of, value, span)),
            Err(ScriptFault::DivisionByZero) => "a division by zero",
            Err(_) => "the result is too large",
        };
        leaves.report(
            Diagnostic::error(TYPES, span, why)
                .label("always")
                .help("these are constants: write what is meant"),
        );
        return None;
    }
    let divides = matches!(term, Term::Int(Binary::Divide | Binary::Remainder) | Term::Real(Binary::Divide));
    if divides && b.constant == Some(0) {
        leaves.report(
            Diagnostic::error(TYPES, span, "a division by zero")
                .label("always")
                .help("divide by what is not zero"),
        );
        return None;
    }
    let mut ops = a.ops;
    ops.extend(b.ops);
    ops.push(Op::Term(term));
    Some(Typed::new(of, ops, span))
}

fn to_real(value: Typed) -> Typed {
    if value.of == Type::Real {
        return value;
    }
    let span = value.span;
    unary(Term::ToReal, Type::Real, value, span)
}

/// The expression of a value, if the value is a bool, as an `if` needs. Reports a value of any other type.
pub(super) fn truth(leaves: &mut impl Leaves, value: Typed, of: &str) -> Option<Typed> {
    if value.of == Type::Bool {
        return Some(value);
    }
    let label = if value.of == Type::Real { "a real" } else { "an integer" };
    let found = mismatch(&format!("{of} wants a bool"), value.span, label);
    leaves.report(found.help("compare it: `x > 0`"));
    None
}

/// The value converted to this type. `place` names its destination in diagnostics.
pub(super) fn coerced(leaves: &mut impl Leaves, value: Typed, of: Type, place: &str) -> Option<Typed> {
    let (wanted, has) = (word(of), word(value.of));
    let numbers = value.of != Type::Bool && of != Type::Bool;
    if of == Type::Real && numbers {
        return Some(to_real(value));
    }
    if value.of == Type::Real && numbers {
        leaves.report(
            mismatch(&format!("{place} is {wanted}, not real"), value.span, "a real")
                .help("a real is not cut off by itself: write `trunc(..)` for its whole part"),
        );
        return None;
    }
    if !numbers && of != value.of {
        let has = if value.of == Type::Bool {
            "a bool"
        } else if value.constant.is_some() {
            "a number"
        } else {
            has
        };
        leaves.report(mismatch(&format!("{place} is {wanted}"), value.span, has).help(other_kind(of)));
        return None;
    }
    if let Some(constant) = value.constant
        && !of.holds(constant)
    {
        let (low, high) = range(of);
        leaves.report(
            Diagnostic::error(
                TYPES,
                value.span,
                format!("{constant} does not fit in {place}, which is {wanted}"),
            )
            .label(format!("{wanted} is {low} to {high}"))
            .help("write a number in this range, or choose a larger type"),
        );
        return None;
    }
    Some(value)
}

fn mismatch(message: &str, span: Span, label: &str) -> Diagnostic {
    Diagnostic::error(TYPES, span, message).label(label)
}

/// The advice how to get a bool from a number, or a number from a bool.
const fn other_kind(wanted: Type) -> &'static str {
    match wanted {
        Type::Bool => "a number is compared to get a bool: `x <> 0`",
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word | Type::Real => {
            "a bool is not a number: write `if b then x := 1; else x := 0; end`"
        }
    }
}

/// The keyword of a type.
pub(crate) const fn word(of: Type) -> &'static str {
    match of {
        Type::Bool => "bool",
        Type::Int8 => "int8",
        Type::Int16 => "int16",
        Type::Int32 => "int32",
        Type::Word => "word",
        Type::Real => "real",
    }
}

/// The least and the greatest value of an integer type.
pub(super) const fn range(of: Type) -> (i64, i64) {
    match of {
        Type::Bool => (0, 1),
        Type::Int8 => (i8::MIN as i64, i8::MAX as i64),
        Type::Int16 => (i16::MIN as i64, i16::MAX as i64),
        Type::Int32 | Type::Real => (i32::MIN as i64, i32::MAX as i64),
        Type::Word => (0, u32::MAX as i64),
    }
}

const fn sign(operator: Binary) -> &'static str {
    match operator {
        Binary::Add => "`+`",
        Binary::Subtract => "`-`",
        Binary::Multiply => "`*`",
        Binary::Divide => "`/`",
        Binary::Remainder => "`mod`",
        Binary::Equal => "`=`",
        Binary::NotEqual => "`<>`",
        Binary::Less => "`<`",
        Binary::LessOrEqual => "`<=`",
        Binary::Greater => "`>`",
        Binary::GreaterOrEqual => "`>=`",
        Binary::And => "`and`",
        Binary::Or => "`or`",
    }
}
