//! The query language: conditions on rows and cells. `/` filters the rows of a screen, and `--assert` exits with code 1
//! unless a cell fulfils a condition.
//!
//! ```text
//! condition  = and ("or" and)*
//! and        = unary ("and" unary)*
//! unary      = "not" unary | "(" condition ")" | comparison | words
//! comparison = value ("=" | "==" | "!=" | "<" | "<=" | ">" | ">=" | "~") literal
//! literal    = 3 | 20ms | 80% | word | "some words"
//! ```
//!
//! Words without an operator match if a row's names contain them. `~` tests whether a text contains another. A missing
//! value (the slack of an empty port) fulfils only `!=`.

mod amount;
mod assertion;
mod fields;
mod parse;

pub use assertion::{Assertion, Held};
pub use fields::{EventRow, FIELDS, Field, FieldInfo, Kind, NodeRow, PortRow, Row, Scope};
pub use parse::QueryError;

use std::borrow::Cow;

/// The value of a field, or a literal.
#[derive(Clone, Debug, PartialEq)]
pub enum Value<'a> {
    /// The row has no value of this field.
    Missing,
    /// A count or a percentage.
    Number(f64),
    /// A length of time in microseconds.
    Time(f64),
    /// A name or a word; comparisons ignore case.
    Text(Cow<'a, str>),
}

/// A comparison operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// `=`, `==`
    Equal,
    /// `!=`
    Unequal,
    /// `<`
    Less,
    /// `<=`
    LessOrEqual,
    /// `>`
    Greater,
    /// `>=`
    GreaterOrEqual,
    /// `~`
    Contains,
}

/// A condition on operands of one kind: fields of a row, or quantities of a cell.
#[derive(Clone, Debug, PartialEq)]
enum Condition<T> {
    And(Vec<Condition<T>>),
    Or(Vec<Condition<T>>),
    Not(Box<Condition<T>>),
    Compare(T, Operator, Value<'static>),
    /// A comparison of two quantities of a cell.
    Against(T, Operator, T),
    /// The condition that the row's names contain the words.
    Words(String),
}

impl<T> Condition<T> {
    fn holds(
        &self,
        compare: &impl Fn(&T, Operator, Right<'_, T>) -> bool,
        words: &impl Fn(&str) -> bool,
    ) -> bool {
        match self {
            Self::And(all) => all.iter().all(|one| one.holds(compare, words)),
            Self::Or(all) => all.iter().any(|one| one.holds(compare, words)),
            Self::Not(one) => !one.holds(compare, words),
            Self::Compare(left, operator, right) => compare(left, *operator, Right::Value(right)),
            Self::Against(left, operator, right) => compare(left, *operator, Right::Operand(right)),
            Self::Words(text) => words(text),
        }
    }
}

impl<T: Copy> Condition<T> {
    /// Adds what the condition compares.
    fn operands(&self, found: &mut Vec<T>) {
        match self {
            Self::And(all) | Self::Or(all) => all.iter().for_each(|one| one.operands(found)),
            Self::Not(one) => one.operands(found),
            Self::Compare(left, ..) => found.push(*left),
            Self::Against(left, _, right) => found.extend([*left, *right]),
            Self::Words(_) => {}
        }
    }
}

/// The right side of a comparison.
enum Right<'a, T> {
    Value(&'a Value<'static>),
    Operand(&'a T),
}

/// A filter of rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Filter(Condition<Field>);

impl Filter {
    /// Parses a filter. Returns `None` if the text is empty.
    ///
    /// # Errors
    /// [`QueryError`]: the column of the error, and what is expected there.
    pub fn parse(text: &str) -> Result<Option<Self>, QueryError> {
        if text.trim().is_empty() {
            return Ok(None);
        }
        parse::filter(text).map(|condition| Some(Self(condition)))
    }

    /// As [`parse`](Self::parse), but an invalid or unfinished condition becomes plain words to search for.
    #[must_use]
    pub fn lenient(text: &str) -> Option<Self> {
        Self::parse(text).unwrap_or_else(|_| Some(Self(Condition::Words(text.to_lowercase()))))
    }

    /// Whether the filter is plain words. Then all rows within a matching row match, too.
    #[must_use]
    pub const fn is_words(&self) -> bool {
        matches!(self.0, Condition::Words(_))
    }

    /// The first field of the filter that rows of this scope do not have: `fill` of an event.
    #[must_use]
    pub fn foreign(&self, scope: Scope) -> Option<&'static str> {
        let mut fields = Vec::new();
        self.0.operands(&mut fields);
        let used =
            |info: &&FieldInfo| ![Scope::Both, scope].contains(&info.scope) && fields.contains(&info.field);
        FIELDS.iter().find(used).map(|info| info.name)
    }

    /// Whether `row` matches the filter.
    #[must_use]
    pub fn takes(&self, row: &impl Row) -> bool {
        let compare = |field: &Field, operator, right: Right<'_, Field>| match right {
            Right::Value(right) => operator_holds(&row.field(*field), operator, right),
            Right::Operand(right) => operator_holds(&row.field(*field), operator, &row.field(*right)),
        };
        self.0.holds(&compare, &|words| row.mentions(words))
    }
}

/// Compares two values. If their types differ, or one of them is missing, only `!=` holds.
fn operator_holds(left: &Value<'_>, operator: Operator, right: &Value<'_>) -> bool {
    let order = match (left, right) {
        (Value::Number(a), Value::Number(b)) | (Value::Time(a), Value::Time(b)) => a.partial_cmp(b),
        (Value::Text(a), Value::Text(b)) => {
            let (a, b) = (a.to_lowercase(), b.to_lowercase());
            if operator == Operator::Contains {
                return a.contains(&b);
            }
            Some(a.cmp(&b))
        }
        _ => None,
    };
    let Some(order) = order else { return operator == Operator::Unequal };
    match operator {
        Operator::Equal | Operator::Contains => order.is_eq(),
        Operator::Unequal => order.is_ne(),
        Operator::Less => order.is_lt(),
        Operator::LessOrEqual => order.is_le(),
        Operator::Greater => order.is_gt(),
        Operator::GreaterOrEqual => order.is_ge(),
    }
}
