//! The operands of assertions: quantities of a whole cell.

use super::Condition;
use super::fields::Field;

/// How the values of a field in all rows are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Aggregate {
    Sum,
    Min,
    Max,
}

impl Aggregate {
    pub const ALL: [Self; 3] = [Self::Sum, Self::Min, Self::Max];

    pub const fn word(self) -> &'static str {
        match self {
            Self::Sum => "sum",
            Self::Min => "min",
            Self::Max => "max",
        }
    }

    pub fn named(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|aggregate| aggregate.word() == word)
    }
}

/// A quantity of a whole cell.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Amount {
    /// A field, combined over all ports.
    Over(Aggregate, Field),
    /// The number of ports that fulfil a condition.
    Count(Condition<Field>),
    /// The number of nodes that are up.
    Up,
    /// The number of nodes that the cell declares.
    Nodes,
    /// The number of nodes that the cell declares and that are not up.
    Missing,
    /// The number of findings that are more than notes.
    Findings,
    /// The number of critical findings.
    Critical,
    /// The number of events that the nodes could not keep for the monitor.
    Lost,
}

impl Amount {
    pub fn named(word: &str) -> Option<Self> {
        Some(match word {
            "up" => Self::Up,
            "nodes" => Self::Nodes,
            "missing" => Self::Missing,
            "findings" => Self::Findings,
            "critical" => Self::Critical,
            "lost" => Self::Lost,
            _ => return None,
        })
    }
}
