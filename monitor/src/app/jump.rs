//! Jumps: to the next match or finding, and within the events.

use super::{App, Screen};
use crate::clock::Moment;
use crate::keys::Action;
use crate::rows::Row;
use crate::store::health::Place;
use crate::store::journal::Severity;

impl App {
    /// Selects the place that blocks the cell most.
    pub(super) fn go_to_culprit(&mut self, now: Moment) {
        match self.blockers(now).first() {
            Some(blocker) => self.go_to(blocker.place, now),
            None => self.told = Some("no single blocker".to_owned()),
        }
    }

    /// Whether the cursor is on the banner.
    #[must_use]
    pub const fn is_on_banner(&self) -> bool {
        self.on_banner
    }

    /// Selects the row above; above the first row, the banner if it leads to a place.
    pub(super) fn step_up(&mut self, now: Moment) {
        let before = self.line(now);
        self.step(-1, now);
        let has_banner = self.drawn.screen == self.screen && self.drawn.banner.is_some();
        self.on_banner = has_banner && self.line(now) == before;
    }

    /// Carries out an action that means something else while the cursor is on the banner. Returns whether it did.
    pub(super) fn act_on_banner(&mut self, action: Action, now: Moment) -> bool {
        match (action, self.drawn.banner) {
            (Action::Up, _) => self.on_banner = true,
            // The cursor moves from the banner to the first row, which is still selected.
            (Action::Down, _) => {}
            (Action::Enter, Some(place)) => self.go_to(place, now),
            _ => return false,
        }
        true
    }

    /// Selects a place in the overview. Changes the settings that hide its row.
    pub(super) fn go_to(&mut self, place: Place, now: Moment) {
        if self.screen != Screen::Overview {
            (self.before, self.screen) = (self.screen, Screen::Overview);
        }
        (self.selected, self.scroll) = (Some(place), 0);
        let findings = self.findings(now);
        let is_shown = |app: &Self| app.rows(&findings, now).iter().any(|row| row.place == place);
        if !is_shown(self) {
            self.shape.filter.clear();
        }
        if place.node.is_ok_and(|node| self.healthy(&findings, now).contains(&node)) {
            self.shape.toggled.insert(Place::HEALTHY);
        }
        for parent in [Place { task: None, port: None, ..place }, Place { port: None, ..place }] {
            if !is_shown(self) && !self.shape.toggled.remove(&parent) {
                self.shape.toggled.insert(parent);
            }
        }
    }

    /// Moves to the next row that matches the filter itself; without a filter, to the next row with a finding.
    pub(super) fn jump_to_match(&mut self, forward: bool, now: Moment) {
        match self.screen {
            Screen::Overview => {
                let findings = self.findings(now);
                let rows = self.rows(&findings, now);
                let at = self.selected(&rows);
                let fits = |row: &Row| {
                    if self.shape.filter.is_empty() {
                        findings.iter().any(|f| f.place == row.place)
                    } else {
                        let label = crate::view::label(self, row.place).to_lowercase();
                        let own = label.rsplit('.').next().unwrap_or("");
                        own.contains(&self.shape.filter.to_lowercase())
                    }
                };
                let found = if forward {
                    (at + 1..rows.len()).chain(0..at).find(|&i| fits(&rows[i]))
                } else {
                    (0..at).rev().chain((at + 1..rows.len()).rev()).find(|&i| fits(&rows[i]))
                };
                self.selected = found.map(|i| rows[i].place).or(self.selected);
            }
            Screen::Events => self.jump_in_events(forward, Severity::Warn),
            Screen::Port
            | Screen::Message
            | Screen::Rendezvous
            | Screen::Timeline
            | Screen::Timers
            | Screen::Model
            | Screen::Problems
            | Screen::Explain
            | Screen::Settings
            | Screen::Help => {}
        }
    }

    pub(super) fn step_events(&mut self, by: isize) {
        let lines = self.events();
        let last = lines.len().saturating_sub(1);
        let at = self.held.map_or(last, |held| lines.iter().rposition(|e| e.number <= held).unwrap_or(0));
        let to = at.saturating_add_signed(by).min(last);
        let number = lines.get(to).map(|e| e.number);
        self.held = if to == last { None } else { number };
    }

    pub(super) fn jump_to_error(&mut self, forward: bool) {
        self.jump_in_events(forward, Severity::Bad);
    }

    fn jump_in_events(&mut self, forward: bool, least: Severity) {
        let lines = self.events();
        let at = self.held.unwrap_or(u64::MAX);
        let mut bad = lines.iter().filter(|e| e.level() >= least).map(|e| e.number);
        let found = if forward { bad.find(|n| *n > at) } else { bad.rfind(|n| *n < at) };
        if found.is_some() {
            self.held = found;
        }
    }

    /// Hides discards from the events, or shows them again, and follows new events.
    pub(super) fn hide_discards(&mut self) {
        self.discards_hidden = !self.discards_hidden;
        self.held = None;
    }
}
