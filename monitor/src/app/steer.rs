//! Carries out the actions that keys have.

use super::{App, Effect, Kind, PortEnd, Screen, port_end};
use crate::clock::{Moment, Span};
use crate::keys::Action;
use crate::replay::Ribbon;
use crate::rows::Sort;
use crate::store::health::Place;
use imrs_protocol::Usage;

impl App {
    pub(super) fn act(&mut self, action: Action, now: Moment) -> Effect {
        if self.replay.is_some() && (is_winding(action) || action == Action::Pause) {
            self.wind(action, now);
            return Effect::Draw;
        }
        if self.frozen.is_some() && is_winding(action) {
            self.go_back(action, now);
            return Effect::Draw;
        }
        if std::mem::take(&mut self.on_banner) && self.act_on_banner(action, now) {
            return Effect::Draw;
        }
        match action {
            Action::Quit => return Effect::Quit,
            Action::Suspend => return Effect::Suspend,
            Action::Show(screen) => self.show(screen),
            Action::MoreOfStep => return self.turn_panel(),
            Action::Record => return if self.replay.is_some() { Effect::Nothing } else { Effect::Record },
            Action::StepBack | Action::StepOn | Action::PreviousAnomaly | Action::NextAnomaly => {
                return Effect::Nothing;
            }
            Action::Write => return Effect::Write,
            Action::Copy => return self.copy(now),
            Action::Command => self.open_entry(Kind::Command),
            Action::Mark => self.set_mark(now),
            Action::Difference => self.since_mark = self.mark.is_some() && !self.since_mark,
            Action::Cycles => (self.only_cycles, self.scroll) = (!self.only_cycles, 0),
            Action::Closer | Action::Wider => self.zoom(action == Action::Closer),
            Action::NextMatch | Action::PreviousMatch => {
                self.jump_to_match(action == Action::NextMatch, now);
            }
            Action::NextTitle | Action::PreviousTitle => self.next_title(action == Action::NextTitle),
            Action::Oldest | Action::First => self.step(isize::MIN, now),
            Action::Newest => self.step(isize::MAX, now),
            Action::Culprit => self.go_to_culprit(now),
            Action::Pause => self.pause(now),
            Action::Theme => return self.next_theme(),
            Action::Cell => self.next_cell(),
            Action::Filter => self.open_entry(Kind::Filter),
            Action::Sort => self.sort(self.shape.sort.next(), false),
            Action::Invert => self.sort(self.shape.sort, !self.shape.inverted),
            Action::Everything if self.screen == Screen::Timeline => self.thin_chart(),
            Action::Everything if self.screen == Screen::Overview => self.shape.earlier = !self.shape.earlier,
            Action::Everything => {
                self.everything = !self.everything;
                self.held = None;
            }
            Action::Discards => self.hide_discards(),
            Action::NextError | Action::PreviousError => self.jump_to_error(action == Action::NextError),
            Action::Settings => self.toggle_settings(),
            Action::Back => self.back(),
            Action::Enter => return self.enter(now),
            Action::Explain => self.explain(now),
            Action::Left | Action::Right if self.screen == Screen::Port => {
                self.turn(action == Action::Right);
            }
            Action::Left | Action::Right if self.screen == Screen::Timeline => {
                self.next_lane(action == Action::Right);
            }
            Action::Left | Action::Right => self.fold(action == Action::Left, now),
            Action::Up => self.step_up(now),
            Action::Down => self.step(1, now),
            Action::PageUp => self.step(-self.page(), now),
            Action::PageDown => self.step(self.page(), now),
            Action::Last => self.go_to_last(now),
        }
        Effect::Draw
    }

    /// Selects the last row, and follows new rows.
    fn go_to_last(&mut self, now: Moment) {
        self.step(isize::MAX, now);
        self.follow_chart();
    }

    /// Pauses the screen, or resumes it.
    fn pause(&mut self, now: Moment) {
        self.back = super::wind::Back::default();
        self.frozen = match self.frozen.take() {
            Some(_) => None,
            None => Some((Box::new(self.live.clone()), now)),
        };
        // As soon as the nodes send more frames, the paused state is a copy of its own, so its memory is reserved.
        self.history.reserve(if self.frozen.is_some() { self.live.weight() } else { 0 });
        // Only the covered times are kept, because the frames would stay in memory for as long as the pause lasts.
        let film = if self.frozen.is_some() { self.history.film() } else { None };
        self.ribbon = film.as_ref().map(Ribbon::of);
    }

    /// Sorts the overview, and selects its first row, because the user wants to see which row comes first in the new order.
    pub(super) fn sort(&mut self, sort: Sort, inverted: bool) {
        (self.shape.sort, self.shape.inverted) = (sort, inverted);
        self.selected = None;
    }

    pub(super) fn show(&mut self, screen: Screen) {
        if self.screen == Screen::Help && screen == Screen::Help {
            self.screen = self.before;
        } else if screen != self.screen {
            self.before = self.screen;
            self.screen = screen;
            if screen == Screen::Port && self.before == Screen::Overview {
                self.port = self.selected.and_then(port_end);
            }
        }
        if self.screen != Screen::Help && screen != Screen::Help {
            self.title = None;
        }
        if screen == Screen::Timeline {
            self.choose_lanes();
        }
        self.scroll = 0;
        (self.entry, self.problem) = (None, None);
    }

    fn back(&mut self) {
        if self.screen == Screen::Settings {
            self.toggle_settings();
        } else if !self.filter().is_empty() {
            self.filter_mut(self.screen).clear();
        } else if self.screen != Screen::Overview {
            self.screen = match self.screen {
                Screen::Help => self.before,
                Screen::Message => self.chosen_on,
                Screen::Explain => self.explained_on,
                _ => Screen::Overview,
            };
            self.scroll = 0;
        }
    }

    fn next_cell(&mut self) {
        let cells = self.cells();
        let at = self.cell().and_then(|shown| cells.iter().position(|c| *c == shown)).unwrap_or(0);
        self.cell = cells.get((at + 1) % cells.len().max(1)).cloned();
        self.selected = None;
        self.port = None;
    }

    /// How many rows had room in the last frame.
    fn page(&self) -> isize {
        self.drawn.page.max(1).cast_signed()
    }

    pub(super) fn fold(&mut self, hide: bool, now: Moment) {
        let rows = self.rows(&self.findings(now), now);
        let Some(row) = rows.get(self.selected(&rows)).copied() else { return };
        if row.open == hide && row.parent {
            if !self.shape.toggled.remove(&row.place) {
                self.shape.toggled.insert(row.place);
            }
        } else if hide {
            let parent = Place { task: row.place.task.filter(|_| row.depth == 2), port: None, ..row.place };
            self.selected = Some(parent);
        }
    }

    /// Copies the name of the selected row to the clipboard.
    fn copy(&mut self, now: Moment) -> Effect {
        let names = self.cell().and_then(|cell| self.store().names(&cell).cloned());
        let text = match (self.screen, self.message_here(now), names) {
            (_, Some(key), Some(names)) => {
                format!("{}.{}#{}", names.task(key.source), names.port_name(key.port), key.number)
            }
            (Screen::Overview, _, _) => {
                let rows = self.rows(&self.findings(now), now);
                let row = rows.get(self.selected(&rows));
                row.map_or_else(String::new, |row| crate::view::label(self, row.place))
            }
            (Screen::Port, None, Some(names)) => {
                let end = self.port(&self.queues());
                end.map_or_else(String::new, |end| {
                    format!("{}.{}", names.task(end.task), names.port_name(end.port))
                })
            }
            _ => String::new(),
        };
        if text.is_empty() {
            self.told = Some("there is nothing to copy here".to_owned());
            return Effect::Draw;
        }
        self.told = Some(format!("copied {text}"));
        Effect::Copy(text)
    }

    pub(super) fn set_mark(&mut self, now: Moment) {
        let at = self.moment(now);
        self.mark = Some(Box::new((at, self.store().clone())));
        self.told = Some(format!("marked at {}; d shows what has changed since", Span(at)));
    }

    pub(super) fn is_waitfor(&self, end: PortEnd) -> bool {
        let view = self.store().incarnation(end.incarnation).and_then(|l| l.port(end.task, end.port));
        view.is_some_and(|v| v.usage == Usage::Waitfor)
    }

    fn turn(&mut self, forward: bool) {
        let queues = self.queues();
        if queues.is_empty() {
            return;
        }
        let at = self.port(&queues).and_then(|end| queues.iter().position(|q| *q == end));
        let (count, at) = (queues.len(), at.unwrap_or(0));
        self.port = Some(queues[if forward { (at + 1) % count } else { (at + count - 1) % count }]);
        self.scroll = 0;
    }

    pub(super) fn step(&mut self, by: isize, now: Moment) {
        match self.screen {
            Screen::Overview => {
                let rows = self.rows(&self.findings(now), now);
                let last = rows.len().saturating_sub(1);
                let to = self.selected(&rows).saturating_add_signed(by).min(last);
                self.selected = rows.get(to).map(|r| r.place);
            }
            Screen::Events => self.step_events(by),
            Screen::Timeline => self.step_chart(by),
            Screen::Port => self.step_queue(by, now),
            Screen::Problems => self.step_problem(by, now),
            Screen::Message
            | Screen::Rendezvous
            | Screen::Timers
            | Screen::Model
            | Screen::Explain
            | Screen::Settings
            | Screen::Help => {
                // Before the screen was drawn, its number of lines is unknown; drawing then limits the position.
                let known = self.drawn.screen == self.screen;
                let most = if known { self.drawn.lines.saturating_sub(1) } else { usize::MAX };
                self.scroll = self.scroll.min(most).saturating_add_signed(by).min(most);
            }
        }
    }

    pub(super) fn step_queue(&mut self, by: isize, now: Moment) {
        let queue = self.queue(now);
        let to = self.entry(&queue).saturating_add_signed(by).min(queue.len().saturating_sub(1));
        let entry = queue.get(to).map(|w| (w.entry.source, w.entry.id));
        (self.scroll, self.entry) = (to, entry);
    }
}

/// Whether an action moves in a recording or, while paused, in the history.
const fn is_winding(action: Action) -> bool {
    matches!(
        action,
        Action::StepBack
            | Action::StepOn
            | Action::PreviousAnomaly
            | Action::NextAnomaly
            | Action::Oldest
            | Action::Newest
    )
}
