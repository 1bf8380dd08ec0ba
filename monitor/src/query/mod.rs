//! Conditions in words, the same everywhere: `/` on a screen picks the rows that fulfil one, `--assert` ends with exit code 1
//! unless a cell fulfils one.
//!
//! ```text
//! condition  = and ("or" and)*
//! and        = unary ("and" unary)*
//! unary      = "not" unary | "(" condition ")" | comparison | words
//! comparison = value ("=" | "==" | "!=" | "<" | "<=" | ">" | ">=" | "~") literal
//! literal    = 3 | 20ms | 80% | word | "some words"
//! ```
//!
//! Words without an operator are looked for in the names of a row. `~` asks whether a text has another in it. What a row
//! does not have (the slack of an empty port) fulfils no comparison but `!=`.

mod amount;
mod assertion;
mod fields;
mod parse;

pub use assertion::{Assertion, Held};
pub use fields::{EventRow, FIELDS, Field, FieldInfo, Kind, NodeRow, PortRow, Row};
pub use parse::QueryError;

use std::borrow::Cow;

/// What a field of a row has, or what it is compared with.
#[derive(Clone, Debug, PartialEq)]
pub enum Value<'a> {
    /// Nothing.
    Missing,
    /// A count, or a part of a hundred.
    Number(f64),
    /// Microseconds.
    Time(f64),
    /// A name or a word; compared without regard to case.
    Text(Cow<'a, str>),
}

/// How two values are compared.
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

/// A condition over operands of one kind: the fields of a row, or what is known of a whole cell.
#[derive(Clone, Debug, PartialEq)]
enum Condition<T> {
    And(Vec<Condition<T>>),
    Or(Vec<Condition<T>>),
    Not(Box<Condition<T>>),
    Compare(T, Operator, Value<'static>),
    /// The words occur in the row's names.
    Words(String),
}

impl<T> Condition<T> {
    fn holds(
        &self,
        compare: &impl Fn(&T, Operator, &Value<'_>) -> bool,
        words: &impl Fn(&str) -> bool,
    ) -> bool {
        match self {
            Self::And(all) => all.iter().all(|one| one.holds(compare, words)),
            Self::Or(all) => all.iter().any(|one| one.holds(compare, words)),
            Self::Not(one) => !one.holds(compare, words),
            Self::Compare(left, operator, right) => compare(left, *operator, right),
            Self::Words(text) => words(text),
        }
    }
}

/// Which rows are wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct Filter(Condition<Field>);

impl Filter {
    /// The filter that `text` says; none where it says nothing.
    ///
    /// # Errors
    /// [`QueryError`]: where in the text, and what would be right there.
    pub fn parse(text: &str) -> Result<Option<Self>, QueryError> {
        if text.trim().is_empty() {
            return Ok(None);
        }
        parse::filter(text).map(|condition| Some(Self(condition)))
    }

    /// As [`parse`](Self::parse), but a text that is no condition, or not yet, is looked for as it is.
    #[must_use]
    pub fn lenient(text: &str) -> Option<Self> {
        Self::parse(text).unwrap_or_else(|_| Some(Self(Condition::Words(text.to_lowercase()))))
    }

    /// Whether it is only words to look for: then what lies within a row that has them is wanted, too.
    #[must_use]
    pub const fn is_words(&self) -> bool {
        matches!(self.0, Condition::Words(_))
    }

    /// Whether `row` is wanted.
    #[must_use]
    pub fn takes(&self, row: &impl Row) -> bool {
        let compare =
            |field: &Field, operator, right: &Value<'_>| operator_holds(&row.field(*field), operator, right);
        self.0.holds(&compare, &|words| row.mentions(words))
    }
}

/// Whether two values stand in a relation. Values of different kinds, and missing ones, are only unequal.
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
