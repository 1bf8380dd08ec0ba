//! The selected title of a column or figure. The bottom line explains it, and the help begins with it.

use super::{App, Effect, Screen};
use crate::clock::Moment;
use crate::keys::Action;

impl App {
    /// The selected title.
    #[must_use]
    pub const fn title(&self) -> Option<&'static str> {
        self.title
    }

    /// Carries out the action of a key. A title stays selected while the user goes through the titles and in the help.
    pub(super) fn press(&mut self, action: Action, now: Moment) -> Effect {
        let is_about_titles =
            matches!(action, Action::NextTitle | Action::PreviousTitle | Action::Show(Screen::Help));
        let dropped = if is_about_titles || self.screen == Screen::Help { None } else { self.title.take() };
        if dropped.is_some() && action == Action::Back {
            return Effect::Draw;
        }
        let effect = self.act(action, now);
        if dropped.is_some() && effect == Effect::Nothing { Effect::Draw } else { effect }
    }

    /// Selects the title after or before the selected one, in reading order.
    pub(super) fn next_title(&mut self, forward: bool) {
        let titles = if self.drawn.screen == self.screen { self.drawn.titles() } else { Vec::new() };
        if titles.is_empty() {
            self.told = Some("no column and no figure of this screen has a title".to_owned());
            return;
        }
        let count = titles.len();
        let at = self.title.and_then(|title| titles.iter().position(|known| *known == title));
        let to = match (at, forward) {
            (None, true) => 0,
            (None, false) => count - 1,
            (Some(at), true) => (at + 1) % count,
            (Some(at), false) => (at + count - 1) % count,
        };
        self.title = titles.get(to).copied();
    }
}
