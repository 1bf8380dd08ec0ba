//! The data of the app that the screens draw: rows, queues, the selected port and message.

use super::{App, PortEnd, Screen};
use crate::clock::Moment;
use crate::rows::{Row, healthy, rows};
use crate::store::blocked::{Blocker, blockers};
use crate::store::health::{self, Finding, Place};
use crate::store::message::MessageKey;
use crate::store::queue::{Waiting, queue};
use crate::store::{IncarnationId, NodeIncarnation, Store};
use imrs_protocol::{PortView, Usage};
use imrs_wire::obs::TaskSnapshot;

impl App {
    /// The findings in the shown cell: warnings of the monitor about its state.
    #[must_use]
    pub fn findings(&self, now: Moment) -> Vec<Finding> {
        self.cell().map_or_else(Vec::new, |cell| health::findings(self.store(), &cell, self.moment(now)))
    }

    /// What blocks the shown cell, most severe first.
    #[must_use]
    pub fn blockers(&self, now: Moment) -> Vec<Blocker> {
        self.cell().map_or_else(Vec::new, |cell| blockers(self.store(), &cell, self.moment(now)))
    }

    /// The rows of the overview that are shown.
    #[must_use]
    pub fn rows(&self, findings: &[Finding], now: Moment) -> Vec<Row> {
        let Some(cell) = self.cell() else { return Vec::new() };
        let healthy = self.healthy(findings, now);
        rows(self.store(), &cell, &self.shape, (findings, &healthy), self.moment(now))
    }

    /// The healthy nodes of a large cell, which share one row.
    #[must_use]
    pub fn healthy(&self, findings: &[Finding], now: Moment) -> Vec<IncarnationId> {
        let Some(cell) = self.cell() else { return Vec::new() };
        let mut loud = Vec::new();
        for blocker in self.blockers(now) {
            loud.push(blocker.place);
            // A node whose task a block holds is not healthy either.
            let held = blocker.held().iter().filter(|_| blocker.is_alarming());
            let nodes = held.filter_map(|task| self.incarnation_of_task(*task));
            loud.extend(nodes.map(|node| Place { node: Ok(node.id), task: None, port: None }));
        }
        healthy(self.store(), &cell, &self.shape, (findings, &loud), self.moment(now))
    }

    /// The row of the overview that the user has selected.
    #[must_use]
    pub(crate) const fn chosen_row(&self) -> Option<Place> {
        self.selected
    }

    /// The index of the selected row: the row that the user chose, its nearest existing parent, or the first row.
    #[must_use]
    pub fn selected(&self, rows: &[Row]) -> usize {
        let Some(place) = self.selected else { return 0 };
        let fits = |wanted: Place| rows.iter().position(|r| r.place == wanted);
        let node = Place { task: None, port: None, ..place };
        let parents = [place, Place { port: None, ..place }, node, Place::HEALTHY];
        parents.into_iter().find_map(fits).unwrap_or(0)
    }

    /// The ports at the tasks that receive through them, in the order of the overview.
    #[must_use]
    pub fn queues(&self) -> Vec<PortEnd> {
        let Some(cell) = self.cell() else { return Vec::new() };
        let store = self.store();
        let ends = |incarnation: &NodeIncarnation| {
            let (incarnation, tasks) = (incarnation.id, incarnation.tasks().iter());
            let receives = |port: &&PortView| port.capacity > 0 && port.usage != Usage::Waitfor;
            let of = move |task: &TaskSnapshot| {
                let end = |port: &PortView| PortEnd { incarnation, task: task.view.task, port: port.port };
                task.view.ports.iter().filter(receives).map(end).collect::<Vec<_>>()
            };
            tasks.flat_map(of).collect::<Vec<_>>()
        };
        store.present(&cell).flat_map(ends).collect()
    }

    /// The port that is shown: the one that the user chose, or the first of `queues`.
    #[must_use]
    pub fn port(&self, queues: &[PortEnd]) -> Option<PortEnd> {
        let there = |end: &PortEnd| {
            self.store().incarnation(end.incarnation).is_some_and(|l| l.port(end.task, end.port).is_some())
        };
        self.port.filter(there).or_else(|| queues.first().copied())
    }

    /// The index of the selected message of a queue: the message that the user chose while it is queued, otherwise the
    /// one that is now at its position.
    #[must_use]
    pub fn entry(&self, queue: &[Waiting]) -> usize {
        let chosen = |(source, id)| queue.iter().position(|w| (w.entry.source, w.entry.id) == (source, id));
        self.entry.and_then(chosen).unwrap_or(self.scroll).min(queue.len().saturating_sub(1))
    }

    /// The index of the selected line of the screen's list.
    pub(super) fn line(&self, now: Moment) -> usize {
        match self.screen {
            Screen::Overview => self.selected(&self.rows(&self.findings(now), now)),
            Screen::Port => self.entry(&self.queue(now)),
            Screen::Problems => self.problem(&self.all_problems(now)),
            Screen::Timeline => self.chart().bottom,
            Screen::Events => {
                let held = self.held.unwrap_or(u64::MAX);
                self.events().iter().rposition(|event| event.number <= held).unwrap_or(0)
            }
            _ => self.scroll,
        }
    }

    /// The queue of the shown port.
    #[must_use]
    pub fn queue(&self, now: Moment) -> Vec<Waiting> {
        let end = self.port(&self.queues());
        let incarnation = end.and_then(|end| self.store().incarnation(end.incarnation).zip(Some(end)));
        incarnation.map_or_else(Vec::new, |(incarnation, end)| {
            queue(incarnation, end.task, end.port, self.moment(now))
        })
    }

    /// The filter of the shown screen; empty for screens without one.
    #[must_use]
    pub fn filter(&self) -> &str {
        match self.screen {
            Screen::Overview => &self.shape.filter,
            Screen::Timeline => &self.lane_filter,
            Screen::Events => &self.event_filter,
            Screen::Port
            | Screen::Message
            | Screen::Rendezvous
            | Screen::Timers
            | Screen::Model
            | Screen::Problems
            | Screen::Explain
            | Screen::Settings
            | Screen::Help => "",
        }
    }

    /// The filter of a screen: that of the timeline or the events, otherwise that of the overview.
    pub(super) const fn filter_mut(&mut self, screen: Screen) -> &mut String {
        match screen {
            Screen::Timeline => &mut self.lane_filter,
            Screen::Events => &mut self.event_filter,
            _ => &mut self.shape.filter,
        }
    }

    /// The screen that the help screen explains.
    #[must_use]
    pub const fn helped(&self) -> Screen {
        self.before
    }

    /// The screen over which the settings are shown.
    #[must_use]
    pub const fn settings_over(&self) -> Screen {
        self.settings_over.0
    }

    /// The code whose page is shown.
    #[must_use]
    pub const fn explained(&self) -> Option<&'static str> {
        self.explained
    }

    /// The message whose history is shown.
    #[must_use]
    pub const fn message(&self) -> Option<MessageKey> {
        self.message
    }

    /// The user's mark, and its moment.
    #[must_use]
    pub fn mark(&self) -> Option<(Moment, &Store)> {
        self.mark.as_deref().map(|(at, store)| (*at, store))
    }

    /// The shown event lines, in the order of their first occurrence.
    #[must_use]
    pub fn events(&self) -> Vec<&crate::store::journal::Entry> {
        let mut lines = self.store().journal().lines(self.everything, &self.event_filter);
        lines.retain(|entry| !self.discards_hidden || entry.kind() != "discard");
        lines
    }
}
