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
/// The least width of the column with the queues: its title.
const QUEUE: u16 = 5;
/// The state of a node has several texts. The column of states always has the width of the shortest one, up to this width.
const SHORTEST_STATE: u16 = 20;
/// The health gets up to this many columns, if its texts need them, before sparklines and long states get more than
/// their least width.
const HEALTH_FIRST: u16 = 32;
/// How many columns above its least width the state may take for sparklines.
const SPARKS: u16 = 12;

/// How many columns the longest cells on the screen need.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Needs {
    pub name: u16,
    pub queue: u16,
    /// The width of the longest text of a state, with the usual texts.
    pub state: u16,
    /// The same width for the shortest text of each node's state.
    pub shortest_state: u16,
    /// Two widths of the longest state that has sparklines behind it: with the usual texts, and if each node shows the shortest
    /// of its texts.
    pub sparks: (u16, u16),
    pub health: u16,
}

/// The columns of a list with `width` columns on a screen with `screen` columns, and the indices of the cells that they
/// show. The screen's width alone decides which columns there are, so that a scrollbar removes none. Names, queues and
/// states take what their texts need, and the health takes the rest; no number is cut. `chosen` are the user's own
/// cells; cells at the end that have no room are left out.
pub(super) fn columns(
    (screen, width): (u16, u16),
    needs: Needs,
    chosen: &[usize],
) -> (Vec<Column>, Vec<usize>) {
    let (name, state, cells): (u16, u16, &[usize]) = match screen {
        0..60 => (0, 0, &[0, 2, 3, HEALTH_CELL]),
        60..80 => (18, 14, &[0, 1, 2, 3, HEALTH_CELL]),
        // The column of expired messages is left out: the health counts them, too, and needs the width more.
        80..90 => (20, 22, &[0, 1, 2, 3, HEALTH_CELL]),
        90..116 => (20, 28, &[0, 1, 2, 3, 5, HEALTH_CELL]),
        116..160 => (26, 32, &[0, 1, 2, 3, 4, 5, 6, 7, HEALTH_CELL]),
        _ => (36, 40, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, HEALTH_CELL]),
    };
    let name = if name == 0 { 0 } else { needs.name.clamp(NAME, name) };
    let queue = needs.queue.max(QUEUE);
    let column = |&cell: &usize, state: u16| match cell {
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
        _ if screen < 60 => Column::left("!", 2),
        _ => Column::left("HEALTH", 0),
    };
    let taken = |cells: &[usize], state: u16, open: u16| {
        let width = |cell| match column(cell, state).width {
            0 => open,
            width => width,
        };
        cells.iter().map(|cell| width(cell) + 1).fold(0, u16::saturating_add)
    };
    let mut cells = cells.to_vec();
    if !chosen.is_empty() && screen >= 60 {
        cells = std::iter::once(0).chain(chosen.iter().copied()).collect();
        while taken(&cells, needs.state.min(state).max(1), OPEN) > width && cells.len() > 1 {
            cells.pop();
        }
    }
    // A table column of width 0 would share the remaining width. So the state column, if it is hidden, has width 1.
    let shared = (width + 2).saturating_sub(taken(&cells, 1, 0));
    let state = state_width(shared, state, needs);
    (cells.iter().map(|cell| column(cell, state)).collect(), cells)
}

/// The width of the states, if states and health share `shared` columns. `least` is for states of any length.
fn state_width(shared: u16, least: u16, needs: Needs) -> u16 {
    // Rounded up, so that a countdown that loses a digit does not move the columns.
    let rounded = |need: u16, step: u16| need.div_ceil(step) * step;
    let spare = shared.saturating_sub(rounded(needs.health, 8).min(HEALTH_FIRST));
    let text = rounded(needs.state, 4).min(spare.max(least));
    let (sparks, shortest_sparks) = needs.sparks;
    let sparks = sparks.min(least + SPARKS).min(spare);
    let sparks = if sparks < shortest_sparks { 0 } else { sparks };
    text.max(needs.shortest_state.min(SHORTEST_STATE)).max(sparks).max(1)
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
