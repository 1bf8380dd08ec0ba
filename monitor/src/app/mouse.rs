//! The actions of the mouse. The mouse is optional: every action also has a key.

use super::{App, Effect, Screen};
use crate::clock::Moment;
use crate::keys::Action;
use crate::view::Hit;
use crossterm::event::{MouseButton, MouseEvent, MouseEventKind};

/// How many rows one step of the wheel moves.
const WHEEL: isize = 3;

impl App {
    pub(super) fn clicked(&mut self, event: MouseEvent, now: Moment) -> Effect {
        if !self.mouse {
            return Effect::Nothing;
        }
        match event.kind {
            MouseEventKind::ScrollUp => self.roll(-WHEEL, now),
            MouseEventKind::ScrollDown => self.roll(WHEEL, now),
            MouseEventKind::Down(MouseButton::Left) => {
                // Before the next frame, the targets are those of the screen that was left.
                let known = self.drawn.screen == self.screen;
                let hit = self.drawn.hit(event.column, event.row).filter(|_| known);
                let is_of_line = matches!(hit, Some(Hit::Completion(_) | Hit::Cursor(_)));
                let typed = !is_of_line && self.leave_line();
                self.on_banner = false;
                let answered = self.told.take().is_some();
                let effect = hit.map_or(Effect::Nothing, |hit| self.follow(hit, now));
                if (typed || answered) && effect == Effect::Nothing { Effect::Draw } else { effect }
            }
            MouseEventKind::Down(_)
            | MouseEventKind::Up(_)
            | MouseEventKind::Drag(_)
            | MouseEventKind::Moved
            | MouseEventKind::ScrollLeft
            | MouseEventKind::ScrollRight => Effect::Nothing,
        }
    }

    /// Does what a click on a target does. A click on a row selects it, and a click on the selected row opens it.
    pub(super) fn follow(&mut self, hit: Hit, now: Moment) -> Effect {
        match hit {
            Hit::Tab(screen) => return self.act(Action::Show(screen), now),
            Hit::Key(action) => return self.press(action, now),
            Hit::Row(place) if self.selected == Some(place) => return self.act(Action::Enter, now),
            Hit::Row(place) => self.selected = Some(place),
            Hit::Problem(key) if self.problem == Some(key) => return self.act(Action::Enter, now),
            Hit::Problem(key) => self.choose_problem(key, now),
            Hit::Entry(source, id) if self.entry == Some((source, id)) => {
                return self.act(Action::Enter, now);
            }
            Hit::Entry(source, id) => {
                self.entry = Some((source, id));
                self.step_queue(0, now);
            }
            Hit::Line(line) if self.line(now) == line => return self.act(Action::Enter, now),
            Hit::Line(line) | Hit::Scroll(line) => self.go_to_line(line, now),
            Hit::Scrub(place) => self.scrub_to(place, now),
            Hit::Place(place) => self.go_to(place, now),
            Hit::Lane(task) => self.choose_lane(task),
            Hit::Title(sort, title) => {
                self.sort(sort, self.shape.sort == sort && !self.shape.inverted);
                self.title = Some(title);
            }
            Hit::Column(title) => self.title = Some(title),
            Hit::Command(word) => self.open_command(word),
            Hit::Completion(at) => self.take_completion(at),
            Hit::Cursor(at) => self.move_cursor(at),
            Hit::Trouble => {
                let trouble = self.store().troubles().next().map(str::to_owned);
                self.told = trouble;
            }
            Hit::Fact(text) => self.told = Some(text.to_owned()),
            Hit::Answer => {}
        }
        Effect::Draw
    }

    fn go_to_line(&mut self, line: usize, now: Moment) {
        if self.screen == Screen::Timeline {
            return self.go_to_chart_row(line);
        }
        if self.screen == Screen::Events {
            self.held = self.events().get(line).map(|event| event.number);
            return;
        }
        self.step(isize::MIN, now);
        self.step(isize::try_from(line).unwrap_or(isize::MAX), now);
    }

    /// Moves by a step of the wheel. The wheel stays within the list, so it never selects the banner.
    fn roll(&mut self, by: isize, now: Moment) -> Effect {
        self.on_banner = false;
        self.step(by, now);
        Effect::Draw
    }
}
