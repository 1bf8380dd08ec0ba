//! What Enter does: on each screen it opens what the selected row is about.

use super::slices::Slice;
use super::{App, Effect, Screen, port_end};
use crate::clock::Moment;
use crate::store::health::Place;
use crate::store::journal::{Entry, What};
use crate::store::message::{MessageKey, message_at};
use crate::store::trail::Seen;
use imrs_protocol::TaskId;

impl App {
    /// Opens what the selected row is about.
    pub(super) fn enter(&mut self, now: Moment) -> Effect {
        match self.screen {
            Screen::Settings => return self.change_setting(now),
            Screen::Rendezvous | Screen::Timers | Screen::Model | Screen::Message | Screen::Help => {
                return self.enter_line(now);
            }
            Screen::Problems => self.enter_problem(now),
            Screen::Explain => self.enter_page(now),
            Screen::Overview => self.enter_row(now),
            Screen::Port | Screen::Timeline | Screen::Events => {
                match (self.message_here(now), self.place_here(now)) {
                    (Some(key), _) => {
                        (self.message, self.chosen_on) = (Some(key), self.screen);
                        self.show(Screen::Message);
                    }
                    (None, Some(place)) => self.go_to(place, now),
                    (None, None) => self.told = Some("this row is of no message".to_owned()),
                }
            }
        }
        Effect::Draw
    }

    /// Opens what the selected line of the last frame leads to. In the help, this acts on the screen that the help explains.
    fn enter_line(&mut self, now: Moment) -> Effect {
        let known = self.drawn.screen == self.screen;
        let line = self.scroll.min(self.drawn.lines.saturating_sub(1));
        let hit = self.drawn.opens.get(line).copied().flatten().filter(|_| known);
        let Some(hit) = hit else {
            let what = if self.screen == Screen::Help { "key, command or column" } else { "node or task" };
            self.told = Some(format!("this row is of no {what}"));
            return Effect::Draw;
        };
        if self.screen == Screen::Help {
            self.show(Screen::Help);
        }
        self.follow(hit, now)
    }

    fn enter_row(&mut self, now: Moment) {
        let rows = self.rows(&self.findings(now), now);
        let Some(row) = rows.get(self.selected(&rows)).copied() else { return };
        self.selected = Some(row.place);
        match port_end(row.place) {
            Some(end) if self.is_waitfor(end) => self.show(Screen::Rendezvous),
            Some(_) => self.show(Screen::Port),
            None => self.fold(row.open, now),
        }
    }

    /// The node or task that the selected row is about, on the timeline and the event screen.
    fn place_here(&self, now: Moment) -> Option<Place> {
        match self.screen {
            Screen::Timeline => {
                let chart = self.chart();
                match (chart.mark(chart.bottom), chart.rows.get(chart.bottom)?) {
                    (Some(mark), _) => {
                        Some(Place { node: Ok(mark.incarnation), task: Some(mark.task), port: None })
                    }
                    (None, Slice::Lost(gap)) => {
                        Some(Place { node: Ok(gap.incarnation), task: None, port: None })
                    }
                    (None, _) => None,
                }
            }
            Screen::Events => self.place_of(self.events().get(self.line(now))?),
            _ => None,
        }
    }

    /// The task of an event or, for an event of a node or a link, the node that reported it.
    fn place_of(&self, entry: &Entry) -> Option<Place> {
        // An event carries the names that were known when it occurred. The first events of a node are older than its
        // table of names, so the latest incarnation's names are used.
        let of_node = self.store().incarnations_of(&entry.names.cell).filter(|one| one.node == entry.node);
        let incarnation = self.store().latest(&entry.names.cell, of_node.last()?.node_id)?;
        let names = &incarnation.names;
        let task = match &entry.what {
            What::Observed { task, .. } => *task,
            What::Noticed { object, .. } => {
                let is_named = |task: &TaskId| names.task(*task).shown() == object;
                (0..names.tasks.len()).map(TaskId::from_index).find(is_named)
            }
        };
        let task = task.filter(|task| names.home(*task) == Some(incarnation.node_id));
        Some(Place { node: Ok(incarnation.id), task, port: None })
    }

    /// The message that the selected row is about.
    pub(super) fn message_here(&self, now: Moment) -> Option<MessageKey> {
        match self.screen {
            Screen::Port => {
                let end = self.port(&self.queues())?;
                let queue = self.queue(now);
                let entry = queue.get(self.entry(&queue))?.entry;
                Some(MessageKey {
                    source: entry.source,
                    port: end.port,
                    number: entry.id.sequence.get(),
                    incarnation: Some(entry.id.incarnation),
                })
            }
            Screen::Timeline => {
                let chart = self.chart();
                let mark = chart.mark(chart.bottom)?;
                message_at(self.store(), &self.cell()?, &mark.seen, mark.at)
            }
            Screen::Events => {
                let lines = self.events();
                let held = self.held.unwrap_or(u64::MAX);
                let entry = lines.iter().rfind(|e| e.number <= held)?;
                let (task, what) = entry.observed()?;
                let seen = Seen { mono_us: 0, task, what: *what };
                message_at(self.store(), &entry.names.cell, &seen, entry.at)
            }
            Screen::Message => self.message,
            Screen::Overview
            | Screen::Rendezvous
            | Screen::Timers
            | Screen::Model
            | Screen::Problems
            | Screen::Explain
            | Screen::Settings
            | Screen::Help => None,
        }
    }
}
