//! Resolves `run`: actions of a robot or another machine.

use super::expr::{self, Typed};
use super::scope::Found;
use super::statements::Thread;
use super::{ACTION, INTERVAL, STATEMENT, TYPES};
use crate::ast::{self, Expr as Written, Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::{Destination, Expr, StatementKind};
use crate::span::Span;
use imrs_protocol::script::Type;

/// The types of an action's arguments and result, as its first use has them.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    arguments: Vec<Kind>,
    result: Option<Kind>,
    span: Span,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Bool,
    Int,
    Real,
}

const fn kind(of: Type) -> Kind {
    match of {
        Type::Bool => Kind::Bool,
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word => Kind::Int,
        Type::Real => Kind::Real,
    }
}

impl<'a> Thread<'_, 'a> {
    pub fn run(
        &mut self,
        action: &'a ast::Name,
        arguments: &'a [Written],
        into: &'a [Place],
        range: Option<&'a (Written, Written)>,
        takes: Option<(ast::Duration, ast::Duration)>,
    ) -> Option<StatementKind> {
        let values: Vec<Option<Typed>> =
            arguments.iter().map(|argument| expr::typed(self, argument)).collect();
        let into = match into {
            [] => None,
            [place] => Some(self.find(place)),
            [_, second, ..] => {
                self.report(
                    Diagnostic::error(super::ARGUMENTS, second.span, "an action has one result")
                        .label("one too many")
                        .help("get the others from actions of their own: `run x -> a; run y -> b;`"),
                );
                return None;
            }
        };
        let into = match into {
            None => None,
            Some(Some(Found::One(place))) => Some(place),
            Some(None) => return None,
            Some(Some(Found::Whole(_) | Found::Timer(_))) => {
                self.report(
                    Diagnostic::error(TYPES, action.span, "the result of an action is one number or a bool")
                        .label(format!("the result of `{}`", action.text))
                        .help("name one field: `-> me.height`"),
                );
                return None;
            }
        };
        let range = range.map(|range| self.result_range(range, into.is_some()));
        if let Some((least, most)) = takes
            && least.usec > most.usec
        {
            let span = least.span.to(most.span);
            self.report(
                Diagnostic::error(INTERVAL, span, "`takes` ends before it begins")
                    .label("the shorter time comes first")
                    .help("exchange the two"),
            );
        }
        let none = ast::Duration { usec: 0, span: action.span };
        let arguments =
            values.into_iter().map(|value| value.map(Typed::finish)).collect::<Option<Vec<_>>>()?;
        self.shape(action, &arguments, into)?;
        Some(StatementKind::Run {
            action: action.text.clone(),
            arguments,
            into,
            range: range.flatten(),
            takes: takes.unwrap_or((none, none)),
        })
    }

    fn result_range(&mut self, (low, high): &'a (Written, Written), has_result: bool) -> Option<(i64, i64)> {
        let ends = [low, high].map(|end| {
            let value = expr::typed(self, end)?;
            let value = expr::coerced(self, value, Type::Int32, "an end of the range")?;
            if value.constant.is_none() {
                self.report(
                    Diagnostic::error(TYPES, end.span, "the ends of a range are constants")
                        .label("not constant")
                        .help("write numbers: `in 0 .. 900`"),
                );
            }
            value.constant
        });
        let (low_value, high_value) = (ends[0]?, ends[1]?);
        let span = low.span.to(high.span);
        if low_value > high_value {
            self.report(
                Diagnostic::error(INTERVAL, span, "a range that ends before it begins")
                    .label("the smaller number comes first")
                    .help("exchange the two"),
            );
            return None;
        }
        if !has_result {
            self.report(
                Diagnostic::error(STATEMENT, span, "the range of a result that goes nowhere")
                    .label("of what?")
                    .help("add `-> variable`, or remove the range"),
            );
        }
        Some((low_value, high_value))
    }

    /// All uses of an action in a task must have one shape (types of arguments and result), because the same driver,
    /// command or simulation carries out all of them.
    pub fn shape(&mut self, action: &Name, arguments: &[Expr], into: Option<Destination>) -> Option<()> {
        let shape = Shape {
            arguments: arguments.iter().map(|argument| kind(argument.of)).collect(),
            result: into.map(|to| kind(to.of)),
            span: action.span,
        };
        let key = (self.task, action.text.clone());
        let Some(first) = self.resolver.actions.get_mut(&key) else {
            self.resolver.actions.insert(key, shape);
            return Some(());
        };
        let results = first.result.zip(shape.result).is_none_or(|(a, b)| a == b);
        if first.arguments == shape.arguments && results {
            first.result = first.result.or(shape.result);
            return Some(());
        }
        let span = first.span;
        let (a, b) = (first.arguments.len(), shape.arguments.len());
        let how =
            if a == b { String::from("values of another kind") } else { format!("{b} values, not {a}") };
        self.report(
            Diagnostic::error(ACTION, action.span, format!("action `{}` with two shapes", action.text))
                .label(how)
                .also(span, "first used here")
                .help("give the two actions two names"),
        );
        None
    }
}
