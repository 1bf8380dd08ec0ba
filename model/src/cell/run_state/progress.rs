//! Whether a move is progress: an action ends well, a rendezvous completes, or a live variable changes its value.

use super::{CellMove, RunState};
use crate::cell_state::script::ScriptReaction;
use imrs_protocol::Signal;
use imrs_protocol::script::ScriptInput;

impl RunState {
    /// Makes a move. Returns whether the move was progress; `None` if the move panics.
    pub fn progresses(&mut self, step: CellMove) -> Option<bool> {
        let mut before = std::mem::take(&mut self.before);
        before.take(self);
        let survived = self.survives(step);
        let is_met =
            |turn: &ScriptReaction| matches!(turn.input, ScriptInput::Signal(Signal::Released { .. }));
        let mut further = matches!(step, CellMove::Acted(_, _, true, _));
        further |= self.cell.turns.iter().flatten().any(is_met);
        further = further || before.differs(self);
        self.before = before;
        survived.then_some(further)
    }
}

/// The variables of all tasks before a move.
#[derive(Clone, Debug, Default)]
pub(in crate::cell) struct Before {
    values: Vec<i64>,
    /// For each task with a script: its position, where its values end in the list, and its dead variables as a bit set.
    tasks: Vec<(usize, usize, u64)>,
}

impl Before {
    fn take(&mut self, run_state: &RunState) {
        self.values.clear();
        self.tasks.clear();
        for (task, body) in run_state.cell.bodies.iter().enumerate() {
            let Some(actor) = &body.actor else { continue };
            self.values.extend_from_slice(actor.host.script.variables());
            self.tasks.push((task, self.values.len(), run_state.dead_variables(task)));
        }
    }

    /// Whether a variable that was live before the move, and is live after it, has another value after the move. A dead
    /// variable does not count, because packing resets it.
    fn differs(&self, run_state: &RunState) -> bool {
        let mut from = 0;
        self.tasks.iter().any(|&(task, end, dead)| {
            let before = &self.values[std::mem::replace(&mut from, end)..end];
            let now = run_state.cell.bodies[task]
                .actor
                .as_ref()
                .map_or(before, |actor| actor.host.script.variables());
            if before == now {
                return false;
            }
            let dead = dead | run_state.dead_variables(task);
            let is_live = |at: usize| at >= 64 || dead >> at & 1 == 0;
            before.iter().zip(now).enumerate().any(|(at, (before, now))| before != now && is_live(at))
        })
    }
}
