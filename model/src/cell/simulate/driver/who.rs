//! Who makes a step.

use crate::cell::course::{CellMove, Course};

/// Who may act in a tick.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Who {
    /// An action: task and thread.
    Action(u8, u8),
    /// The packets at the end of a directed link.
    Line(usize),
    /// A task that takes an input, or scripts that begin.
    Input(CellMove),
}

/// Who makes a step, if it is one that somebody makes in a tick.
pub(super) fn who(course: &Course, step: CellMove) -> Option<Who> {
    match step {
        CellMove::Acted(task, level, ..) | CellMove::GoOn(task, level) => Some(Who::Action(task, level)),
        CellMove::Stay(link) => Some(Who::Line(usize::from(link))),
        CellMove::Take(..) | CellMove::Begin(_) => Some(Who::Input(step)),
        _ => {
            let crossing = course.floor.crossings.get(usize::from(step.packet()?))?;
            Some(Who::Line(usize::from(crossing.link)))
        }
    }
}

/// Whether a move is one of a node with something to do in this tick.
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
