//! The actions on the problems screen.

use super::{App, PortEnd, Screen};
use crate::clock::Moment;
use crate::problems::{Problem, ProblemKey, problems};
use crate::store::blocked::Blocker;
use crate::store::health::Finding;
use crate::store::nearest::Near;
use imrs_protocol::Usage;

const fn end(near: &Near) -> PortEnd {
    PortEnd { incarnation: near.incarnation, task: near.task, port: near.port }
}

impl App {
    /// The rows of the problems.
    #[must_use]
    pub fn problems(&self, findings: &[Finding], blockers: &[Blocker], now: Moment) -> Vec<Problem> {
        let Some(cell) = self.cell() else { return Vec::new() };
        problems(self.store(), &cell, findings, blockers, self.moment(now))
    }

    /// The index of the selected row: the row that the user chose while it exists, otherwise the row that is now at its
    /// position.
    #[must_use]
    pub fn problem(&self, rows: &[Problem]) -> usize {
        let chosen = self.problem.and_then(|key| rows.iter().position(|row| row.key() == key));
        chosen.unwrap_or(self.scroll).min(rows.len().saturating_sub(1))
    }

    pub(super) fn all_problems(&self, now: Moment) -> Vec<Problem> {
        self.problems(&self.findings(now), &self.blockers(now), now)
    }

    pub(super) fn step_problem(&mut self, by: isize, now: Moment) {
        let rows = self.all_problems(now);
        let to = self.problem(&rows).saturating_add_signed(by).min(rows.len().saturating_sub(1));
        (self.scroll, self.problem) = (to, rows.get(to).map(Problem::key));
    }

    pub(super) fn choose_problem(&mut self, key: ProblemKey, now: Moment) {
        self.problem = Some(key);
        self.step_problem(0, now);
    }

    /// Opens the screen for the selected row's problem.
    pub(super) fn enter_problem(&mut self, now: Moment) {
        let rows = self.all_problems(now);
        let Some(row) = rows.get(self.problem(&rows)) else { return };
        self.problem = Some(row.key());
        match row {
            Problem::Block(blocker) => self.go_to(blocker.place, now),
            Problem::Message(near) => {
                self.go_to_queue(end(near));
                self.entry = near.message;
            }
            Problem::Finding { finding, .. } => self.go_to_finding(finding, now),
        }
    }

    /// Opens the screen for the most severe finding that the shown page explains.
    pub(super) fn enter_page(&mut self, now: Moment) {
        let findings = self.findings(now);
        match findings.iter().find(|finding| Some(finding.code) == self.explained) {
            Some(finding) => self.go_to_finding(finding, now),
            None => self.told = Some("this cell has no such finding now".to_owned()),
        }
    }

    fn go_to_finding(&mut self, finding: &Finding, now: Moment) {
        let screen = match finding.code {
            "model-violation" => Some(Screen::Model),
            "wait-cycle" | "divergent-rendezvous" => Some(Screen::Rendezvous),
            "timer-late" => Some(Screen::Timers),
            _ => None,
        };
        let end = super::port_end(finding.place);
        let usage = end.and_then(|end| {
            let view = self.store().incarnation(end.incarnation)?.port(end.task, end.port)?;
            Some((end, view.usage, view.capacity))
        });
        match (screen, usage) {
            (Some(screen), _) => self.open(screen),
            (None, Some((_, Usage::Waitfor, _))) => self.open(Screen::Rendezvous),
            (None, Some((end, _, 1..))) => self.go_to_queue(end),
            (None, _) => self.go_to(finding.place, now),
        }
    }

    fn go_to_queue(&mut self, end: PortEnd) {
        self.open(Screen::Port);
        (self.port, self.entry) = (Some(end), None);
    }

    /// Shows the page about a code.
    pub(super) fn open_page(&mut self, code: &'static str) {
        (self.explained, self.explained_on) = (Some(code), self.screen);
        self.open(Screen::Explain);
    }

    /// Shows a screen, scrolled to its beginning.
    fn open(&mut self, screen: Screen) {
        (self.before, self.screen, self.scroll) = (self.screen, screen, 0);
    }

    /// Shows the page about the selected row's code.
    pub(super) fn explain(&mut self, now: Moment) {
        let findings = self.findings(now);
        let code = match self.screen {
            Screen::Problems => {
                let rows = self.problems(&findings, &self.blockers(now), now);
                match rows.get(self.problem(&rows)) {
                    Some(Problem::Finding { finding, .. }) => Some(finding.code),
                    Some(Problem::Message(_)) => Some("deadline-risk"),
                    Some(Problem::Block(blocker)) => Some(blocker.code),
                    None => None,
                }
            }
            _ => {
                let rows = self.rows(&findings, now);
                let row = rows.get(self.selected(&rows));
                row.and_then(|row| findings.iter().find(|f| row.place.holds(&f.place))).map(|f| f.code)
            }
        };
        match code {
            Some(code) => self.open_page(code),
            None => self.told = Some("there is no finding here".to_owned()),
        }
    }
}
