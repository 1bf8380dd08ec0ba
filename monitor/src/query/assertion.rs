//! Assertions: conditions on a whole cell, for scripts and continuous integration.

use super::amount::{Aggregate, Amount};
use super::fields::{Field, PortRow, Row};
use super::parse::{self, QueryError};
use super::{Condition, Filter, Right, Value, operator_holds};
use crate::clock::{Moment, Span};
use crate::name::Name;
use crate::store::health::{Finding, findings};
use crate::store::journal::Severity;
use crate::store::{NodeIncarnation, Presence, Store};
use std::cell::RefCell;

/// A condition on a whole cell: `expired==0 and min_slack>5ms`, `count(class=2 and fill>80%) == 0 and up>=3`.
#[derive(Clone, Debug, PartialEq)]
pub struct Assertion {
    text: String,
    condition: Condition<Amount>,
}

/// The result of evaluating an assertion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    /// Whether the assertion holds.
    pub holds: bool,
    /// The compared quantities with their present values: `expired = 3`.
    pub values: Vec<String>,
}

impl std::str::FromStr for Assertion {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse::assertion(text).map(|condition| Self { text: text.to_owned(), condition })
    }
}

impl Assertion {
    /// The text of the assertion.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Evaluates the assertion over the cells `wanted` together.
    #[must_use]
    pub fn holds(&self, store: &Store, wanted: &[Name], now: Moment) -> Held {
        let cells: Vec<_> = wanted.iter().map(|cell| (cell, findings(store, cell, now))).collect();
        let values = RefCell::new(Vec::new());
        let value = |amount: &Amount, time| {
            let value = amount.value(store, &cells, now, time);
            let said = format!("{} = {}", amount.name(), shown(&value));
            if !values.borrow().contains(&said) {
                values.borrow_mut().push(said);
            }
            value
        };
        let compare = |amount: &Amount, operator, right: Right<'_, Amount>| match right {
            Right::Value(right) => {
                operator_holds(&value(amount, matches!(right, Value::Time(_))), operator, right)
            }
            Right::Operand(right) => operator_holds(&value(amount, false), operator, &value(right, false)),
        };
        let holds = self.condition.holds(&compare, &|_| false);
        Held { holds, values: values.into_inner() }
    }
}

fn shown(value: &Value<'_>) -> String {
    match value {
        Value::Missing => "nothing".to_owned(),
        Value::Number(number) if number.is_infinite() => "nothing".to_owned(),
        Value::Time(us) if us.is_infinite() => "nothing".to_owned(),
        Value::Number(number) => format!("{number}"),
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time for people")]
        Value::Time(us) => Span::micros(*us as u64).to_string(),
        Value::Text(text) => text.to_string(),
    }
}

type Cells<'a> = [(&'a Name, Vec<Finding>)];

impl Amount {
    fn name(&self) -> String {
        match self {
            Self::Over(aggregate, field) => {
                let name =
                    super::FIELDS.iter().find(|info| info.field == *field).map_or("", |info| info.name);
                if *aggregate == Aggregate::Sum {
                    name.to_owned()
                } else {
                    format!("{}({name})", aggregate.word())
                }
            }
            Self::Count(_) => "count(...)".to_owned(),
            Self::Up => "up".to_owned(),
            Self::Nodes => "nodes".to_owned(),
            Self::Missing => "missing".to_owned(),
            Self::Findings => "findings".to_owned(),
            Self::Critical => "critical".to_owned(),
            Self::Lost => "lost".to_owned(),
        }
    }

    fn value(&self, store: &Store, cells: &Cells<'_>, now: Moment, time: bool) -> Value<'static> {
        #[expect(clippy::cast_precision_loss, reason = "a count for comparing")]
        let number = |count: usize| Value::Number(count as f64);
        let incarnations = || cells.iter().flat_map(|(cell, _)| store.incarnations_of(cell));
        let known = |cell: &Name| store.names(cell).map_or(0, |names| names.nodes.len());
        let declared = || cells.iter().map(|(cell, _)| known(cell)).sum::<usize>();
        match self {
            Self::Over(aggregate, field) => over(*aggregate, *field, store, cells, now, time),
            Self::Count(condition) => {
                let filter = Filter(condition.clone());
                let mut count = 0;
                each_port(store, cells, now, &mut |row| count += usize::from(filter.takes(row)));
                number(count)
            }
            Self::Up => number(count_up(incarnations(), now)),
            Self::Nodes => number(declared()),
            Self::Missing => {
                let present = cells.iter().flat_map(|(cell, _)| store.present(cell));
                number(declared().saturating_sub(count_up(present, now)))
            }
            Self::Findings | Self::Critical => {
                let least = if *self == Self::Critical { Severity::Bad } else { Severity::Warn };
                number(cells.iter().flat_map(|(_, all)| all).filter(|f| f.level >= least).count())
            }
            #[expect(clippy::cast_precision_loss, reason = "a count for comparing")]
            Self::Lost => {
                Value::Number(incarnations().map(|incarnation| incarnation.lost).sum::<u64>() as f64)
            }
        }
    }
}

/// How many of these nodes are up.
fn count_up<'a>(incarnations: impl Iterator<Item = &'a NodeIncarnation>, now: Moment) -> usize {
    incarnations.filter(|incarnation| incarnation.presence(now) == Presence::Up).count()
}

/// A field, combined over all ports that have it. Without such a port, the minimum is positive infinity, and the
/// maximum negative infinity.
fn over(
    aggregate: Aggregate,
    field: Field,
    store: &Store,
    cells: &Cells<'_>,
    now: Moment,
    time: bool,
) -> Value<'static> {
    let mut whole = match aggregate {
        Aggregate::Sum => 0.0,
        Aggregate::Min => f64::INFINITY,
        Aggregate::Max => f64::NEG_INFINITY,
    };
    each_port(store, cells, now, &mut |row| {
        let (Value::Number(value) | Value::Time(value)) = row.field(field) else { return };
        whole = match aggregate {
            Aggregate::Sum => whole + value,
            Aggregate::Min => whole.min(value),
            Aggregate::Max => whole.max(value),
        };
    });
    if time { Value::Time(whole) } else { Value::Number(whole) }
}

/// Calls `each` for every port of the latest incarnation of each node.
fn each_port(store: &Store, cells: &Cells<'_>, now: Moment, each: &mut impl FnMut(&PortRow<'_>)) {
    for (cell, findings) in cells {
        for incarnation in store.present(cell) {
            for task in incarnation.tasks() {
                for port in &task.view.ports {
                    each(&PortRow { store, incarnation, task, port, findings, now });
                }
            }
        }
    }
}
