//! The columns of the overview.

use super::canvas::Column;
use crate::rows::Sort;

const NAME: Column = Column::left("NODE/TASK/PORT", 0);
const HEALTH: Column = Column::left("HEALTH", 0);

/// The index of the health cell.
pub(super) const HEALTH_CELL: usize = 10;

/// The columns for a width, and the indices of the cells that they show.
pub(super) fn columns(width: u16) -> (Vec<Column>, &'static [usize]) {
    let state = |w| Column::left("STATE", w);
    let queue = |w| Column::left("QUEUE", w);
    let slack = Column::right("SLACK", 7);
    match width {
        0..60 => (vec![NAME, queue(5), slack, Column::left("", 2)], &[0, 2, 3, HEALTH_CELL]),
        60..80 => (
            vec![Column::left(NAME.title, 18), state(14), queue(5), slack, HEALTH],
            &[0, 1, 2, 3, HEALTH_CELL],
        ),
        80..116 => (
            vec![
                Column::left(NAME.title, 20),
                state(if width < 90 { 22 } else { 28 }),
                queue(5),
                slack,
                Column::right("EXP", 4),
                HEALTH,
            ],
            &[0, 1, 2, 3, 5, HEALTH_CELL],
        ),
        116..160 => (
            vec![
                Column::left(NAME.title, 26),
                state(28),
                queue(11),
                slack,
                Column::right("MSG/s", 6),
                Column::right("EXP", 4),
                Column::right("OVF", 4),
                Column::right("REJ", 4),
                HEALTH,
            ],
            &[0, 1, 2, 3, 4, 5, 6, 7, HEALTH_CELL],
        ),
        _ => (
            vec![
                Column::left(NAME.title, 36),
                state(40),
                queue(11),
                slack,
                Column::right("MSG/s", 6),
                Column::right("EXP", 4),
                Column::right("OVF", 4),
                Column::right("REJ", 4),
                Column::right("RES", 4),
                Column::right("T/O", 4),
                HEALTH,
            ],
            &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, HEALTH_CELL],
        ),
    }
}

/// The order that a click on a column's title chooses.
pub(super) fn sort_of(title: &str) -> Option<Sort> {
    match title {
        "NODE/TASK/PORT" => Some(Sort::Name),
        "QUEUE" => Some(Sort::Queue),
        "SLACK" => Some(Sort::Slack),
        "HEALTH" => Some(Sort::Health),
        _ => None,
    }
}
