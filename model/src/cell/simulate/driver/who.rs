//! Names the actor of a move: an action, a link or a waiting input.

use crate::cell::run_state::{CellMove, RunState};

/// What may act in a tick.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Who {
    /// An action: task and activation.
    Action(u8, u8),
    /// The packets that are at the end of a directed link.
    Line(usize),
    /// A waiting input that a task takes, or scripts that begin.
    Input(CellMove),
}

/// The actor of a move in a tick; `None` for other moves.
pub(super) fn who(run_state: &RunState, step: CellMove) -> Option<Who> {
    match step {
        CellMove::Acted(task, level, ..) | CellMove::GoOn(task, level) => Some(Who::Action(task, level)),
        CellMove::Stay(link) => Some(Who::Line(usize::from(link))),
        CellMove::Take(..) | CellMove::Begin(_) => Some(Who::Input(step)),
        _ => {
            let carried = run_state.cell.in_flight.get(usize::from(step.packet()?))?;
            Some(Who::Line(usize::from(carried.link)))
        }
    }
}

/// Whether a move is one that a node makes when it has something to do in this tick.
pub(super) const fn is_of_a_turn(step: CellMove) -> bool {
    !matches!(
        step,
        CellMove::Pass
            | CellMove::Drift(..)
            | CellMove::Crash(_)
            | CellMove::Restart(_)
            | CellMove::Pause(..)
            | CellMove::PauseBefore(..)
            | CellMove::PauseNext(..)
            | CellMove::Wake(_)
    )
}
