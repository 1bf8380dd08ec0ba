//! The columns of the overview.

use super::canvas::Column;
use crate::rows::Sort;
use crate::theme::Ink;

/// The cells of a row: name, state, queue, slack, rate, expired, overflow, rejected, re-sent, timed out, health.
pub(super) type Cells = [(String, Ink); 11];

/// The index of the health cell.
pub(super) const HEALTH_CELL: usize = 10;

/// The least width of a column that shares the remaining width.
const OPEN: u16 = 12;
/// The least width of the column with the names.
const NAME: u16 = 14;

/// The columns for a screen of this width, and the indices of the cells that they show. `longest` has the widths of the
/// longest name and the longest queue on the screen. The width that these do not need is for the health, and no number
/// is cut. `chosen` are the user's own cells; cells at the end that have no room are left out.
pub(super) fn columns(width: u16, longest: (u16, u16), chosen: &[usize]) -> (Vec<Column>, Vec<usize>) {
    let (name, state, queue, cells): (u16, u16, u16, &[usize]) = match width {
        0..60 => (0, 0, 5, &[0, 2, 3, HEALTH_CELL]),
        60..80 => (18, 14, 5, &[0, 1, 2, 3, HEALTH_CELL]),
        80..90 => (20, 22, 5, &[0, 1, 2, 3, 5, HEALTH_CELL]),
        90..116 => (20, 28, 5, &[0, 1, 2, 3, 5, HEALTH_CELL]),
        116..160 => (26, 32, 11, &[0, 1, 2, 3, 4, 5, 6, 7, HEALTH_CELL]),
        _ => (36, 40, 11, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, HEALTH_CELL]),
    };
    let name = if name == 0 { 0 } else { longest.0.clamp(NAME, name) };
    let queue = queue.max(longest.1);
    let column = |&cell: &usize| match cell {
        0 => Column::left("NODE/TASK/PORT", name),
        1 => Column::left("STATE", state),
        2 => Column::left("QUEUE", queue),
        3 => Column::right("SLACK", 7),
        4 => Column::right("MSG/s", 6),
        5 => Column::right("EXP", 4),
        6 => Column::right("OVF", 4),
        7 => Column::right("REJ", 4),
        8 => Column::right("RES", 4),
        9 => Column::right("T/O", 4),
        // On the narrowest screens only a sign has room.
        _ if width < 60 => Column::left("!", 2),
        _ => Column::left("HEALTH", 0),
    };
    if chosen.is_empty() || width < 60 {
        return (cells.iter().map(column).collect(), cells.to_vec());
    }
    let mut cells: Vec<usize> = std::iter::once(0).chain(chosen.iter().copied()).collect();
    let taken = |cells: &[usize]| {
        let widths =
            cells.iter().map(column).map(|column| if column.width == 0 { OPEN } else { column.width });
        widths.map(|width| width + 1).fold(0, u16::saturating_add)
    };
    while taken(&cells) > width && cells.len() > 1 {
        cells.pop();
    }
    (cells.iter().map(column).collect(), cells)
}

/// The sort order that a click on this column title chooses.
pub(super) fn sort_of(title: &str) -> Option<Sort> {
    match title {
        "NODE/TASK/PORT" => Some(Sort::Name),
        "QUEUE" => Some(Sort::Queue),
        "SLACK" => Some(Sort::Slack),
        "HEALTH" => Some(Sort::Health),
        _ => None,
    }
}
