//! The actions of the mouse. The mouse is optional: every action also has a key.

use super::{App, Effect, Screen};
use crate::clock::Moment;
use crate::keys::Action;
use crate::view::Hit;
use crossterm::event::{MouseButton, MouseEvent, MouseEventKind};

/// How many rows one step of the wheel moves.
const WHEEL: usize = 3;

impl App {
    pub(super) fn clicked(&mut self, event: MouseEvent, now: Moment) -> Effect {
        if !self.mouse {
            return Effect::Nothing;
        }
        let typed = event.kind == MouseEventKind::Down(MouseButton::Left) && self.leave_line();
        match event.kind {
            MouseEventKind::ScrollUp => self.again(Action::Up, now),
            MouseEventKind::ScrollDown => self.again(Action::Down, now),
            MouseEventKind::Down(MouseButton::Left) => match self.drawn.hit(event.column, event.row) {
                Some(Hit::Tab(screen)) => self.act(Action::Show(screen), now),
                Some(Hit::Row(place)) if self.selected == Some(place) => self.act(Action::Enter, now),
                Some(Hit::Row(place)) => {
                    self.selected = Some(place);
                    Effect::Draw
                }
                Some(Hit::Problem(key)) if self.problem == Some(key) => self.act(Action::Enter, now),
                Some(Hit::Problem(key)) => {
                    self.choose_problem(key, now);
                    Effect::Draw
                }
                Some(Hit::Scrub(place)) => {
                    self.scrub_to(place, now);
                    Effect::Draw
                }
                Some(Hit::Place(place)) => {
                    self.go_to(place, now);
                    Effect::Draw
                }
                Some(Hit::Entry(source, id)) if self.entry == Some((source, id)) => {
                    self.act(Action::Enter, now)
                }
                Some(Hit::Entry(source, id)) => {
                    self.entry = Some((source, id));
                    self.step_queue(0, now);
                    Effect::Draw
                }
                Some(Hit::Line(line)) if self.line() == Some(line) => self.act(Action::Enter, now),
                Some(Hit::Line(line) | Hit::Scroll(line)) => {
                    self.go_to_line(line, now);
                    Effect::Draw
                }
                Some(Hit::Lane(task)) => {
                    self.choose_lane(task);
                    Effect::Draw
                }
                Some(Hit::Title(sort, title)) => {
                    self.sort(sort, self.shape.sort == sort && !self.shape.inverted);
                    self.title = Some(title);
                    Effect::Draw
                }
                Some(Hit::Column(title)) => {
                    self.title = Some(title);
                    Effect::Draw
                }
                Some(Hit::Key(action)) => self.act(action, now),
                None if typed => Effect::Draw,
                None => Effect::Nothing,
            },
            MouseEventKind::Down(_)
            | MouseEventKind::Up(_)
            | MouseEventKind::Drag(_)
            | MouseEventKind::Moved
            | MouseEventKind::ScrollLeft
            | MouseEventKind::ScrollRight => Effect::Nothing,
        }
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

    fn again(&mut self, action: Action, now: Moment) -> Effect {
        for _ in 0..WHEEL {
            self.act(action, now);
        }
        Effect::Draw
    }
}
