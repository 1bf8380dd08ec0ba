//! Moves in a recording, and in the history while the screen is paused.

use super::{App, Effect};
use crate::clock::Moment;
use crate::keys::Action;
use crate::replay::{At, Player, Ribbon};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::thread;

impl App {
    /// Moves in the recording. The screens keep their positions, except for the event screen, which follows the latest event.
    pub(super) fn wind(&mut self, action: Action, now: Moment) {
        let Some(player) = &mut self.replay else { return };
        self.held = None;
        match action {
            Action::Pause => player.toggle(now),
            action => go(player, action),
        }
    }

    /// Shows the next lines of the panel about the shown step of a recording.
    pub(super) fn turn_panel(&mut self) -> Effect {
        let Some(player) = self.replay.as_mut().filter(|player| player.step().is_some()) else {
            return Effect::Nothing;
        };
        player.turn_panel();
        Effect::Draw
    }

    /// Moves in the history before the pause. At the end of the history, the moment of the pause is shown again.
    pub(super) fn go_back(&mut self, action: Action, now: Moment) {
        self.move_back(now, |player| go(player, action));
    }

    /// Moves to a position of the scrub bar.
    pub(super) fn scrub_to(&mut self, place: u64, now: Moment) {
        if let Some(player) = &mut self.replay {
            self.held = None;
            let ribbon = Ribbon::of(player.film());
            player.go_to_place(&ribbon, place);
        } else if let Some(ribbon) = self.ribbon.clone() {
            self.move_back(now, |player| player.go_to_place(&ribbon, place));
        }
    }

    /// Moves the position in the history. The first call makes the player of the history.
    fn move_back(&mut self, now: Moment, go: impl FnOnce(&mut Player) + Send) {
        let paused = self.frozen.as_ref().map_or(now, |(_, at)| *at);
        if self.back.player().is_none() {
            // The history gives up memory for three stores: the player's shown state, the player's kept state for
            // quick steps back, and the state at the pause. Each of the player's two takes a little more than its
            // weight.
            self.history.reserve(self.live.weight() * 7 / 2);
            let Some(film) = self.history.film() else { return };
            self.back = Back(apart(move || {
                let mut player = Player::new(Arc::new(film), 1.0);
                player.seek(At::After(paused));
                Some(Box::new(player))
            }));
        }
        self.held = None;
        let Some(player) = &mut self.back.0 else { return };
        let history = &self.history;
        let has_ended = apart(|| {
            go(player);
            let has_ended = player.stop() >= player.film().stop_at(paused);
            if !has_ended {
                history.verdicts(player.moment()).for_each(|verdict| player.add(verdict));
            }
            has_ended
        });
        if has_ended {
            self.back = Back::default();
            self.history.reserve(self.live.weight());
        }
    }
}

/// Moves a player as the action says. What is no other movement is one to the end.
fn go(player: &mut Player, action: Action) {
    match action {
        Action::StepBack => player.step_by(-1),
        Action::StepOn => player.step_by(1),
        Action::PreviousAnomaly => player.go_to_trouble(false),
        Action::NextAnomaly => player.go_to_trouble(true),
        Action::Oldest => player.go(0),
        _ => player.go_to_end(),
    }
}

/// The player of the history, if the user has moved back. All of its memory belongs to threads of their own ([`apart`]).
#[derive(Clone, Debug, Default)]
pub(super) struct Back(Option<Box<Player>>);

impl Back {
    /// The player, if the user has moved back.
    pub(super) fn player(&self) -> Option<&Player> {
        self.0.as_deref()
    }
}

impl Drop for Back {
    fn drop(&mut self) {
        if let Some(player) = self.0.take() {
            // If the main thread freed this memory, its allocator would keep pieces for later allocations.
            apart(move || drop(player));
        }
    }
}

/// Does work in a thread of its own, and waits for it. The allocator keeps the memory of different threads apart, so
/// all memory of this work returns to the system once it is freed. Memory between longer-lived allocations would not.
fn apart<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let done = thread::scope(|scope| scope.spawn(work).join());
    done.unwrap_or_else(|panic| resume_unwind(panic))
}
