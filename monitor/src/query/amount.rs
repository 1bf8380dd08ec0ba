//! What an assertion may compare.

use super::Condition;
use super::fields::Field;

/// How the values of all rows become one.
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

/// Something that is known of a whole cell.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Amount {
    /// Over all ports.
    Over(Aggregate, Field),
    /// So many ports.
    Count(Condition<Field>),
    /// Nodes that are up.
    Up,
    /// Nodes that the cell declares.
    Nodes,
    /// Those of them that are not up.
    Missing,
    /// What is wrong, of any level but notes.
    Findings,
    /// What is critical.
    Critical,
    /// Events that were lost on the way to the monitor.
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
