//! The command line that opens with `:`.

use super::{App, Effect, PortEnd, Screen};
use crate::clock::Moment;
use crate::options::Endpoint;
use crate::store::health::Place;
use crate::theme::Theme;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_protocol::{NodeId, PortId, TaskId};

/// The commands: what is typed, and what it does.
pub const COMMANDS: [(&str, &str); 5] = [
    ("connect unix:PATH|tcp:HOST:PORT", "attach to one more node"),
    ("port NAME", "the queue of a port (also TASK.PORT)"),
    ("node NAME", "a node, or a task, in the overview"),
    ("theme NAME", "how the screen looks"),
    ("quit", "quit"),
];

impl App {
    pub(super) fn typed_command(&mut self, event: &KeyEvent, now: Moment) -> Effect {
        let ctrl = event.modifiers.contains(KeyModifiers::CONTROL);
        let Some(text) = &mut self.command else { return Effect::Nothing };
        match event.code {
            KeyCode::Char('c') if ctrl => return Effect::Quit,
            KeyCode::Char('z') if ctrl => return Effect::Suspend,
            KeyCode::Char(c) if !ctrl && !c.is_control() => text.push(c),
            KeyCode::Backspace if text.is_empty() => self.command = None,
            KeyCode::Backspace => drop(text.pop()),
            KeyCode::Esc => self.command = None,
            KeyCode::Enter => {
                let text = self.command.take().unwrap_or_default();
                return self.run(text.trim(), now);
            }
            _ => return Effect::Nothing,
        }
        Effect::Draw
    }

    fn run(&mut self, text: &str, now: Moment) -> Effect {
        let (word, rest) = text.split_once(' ').map_or((text, ""), |(word, rest)| (word, rest.trim()));
        self.told = match (word, rest) {
            ("", _) => None,
            ("q" | "quit", "") => return Effect::Quit,
            ("connect", address) => match address.parse::<Endpoint>() {
                Ok(endpoint) => {
                    self.told = Some(format!("attaching to {endpoint}"));
                    return Effect::Connect(endpoint);
                }
                Err(error) => Some(error.to_string()),
            },
            ("port", name) => self.go_to_port(name),
            ("node" | "task", name) => self.go_to_node(name, now),
            ("theme", name) => match Theme::named(name) {
                Some(theme) => {
                    self.theme = theme;
                    None
                }
                None => Some(format!("there is no such theme; there are {}", Theme::names().join(", "))),
            },
            _ => {
                let known = COMMANDS.map(|(usage, _)| format!(":{usage}")).join("  ");
                Some(format!("no such command; there are {known}"))
            }
        };
        Effect::Draw
    }

    /// Shows the queue of a port, at the task that receives there.
    fn go_to_port(&mut self, wanted: &str) -> Option<String> {
        let (task, port) = wanted.split_once('.').map_or((None, wanted), |(task, port)| (Some(task), port));
        let cell = self.cell()?;
        let names = self.store().names(&cell)?.clone();
        let is = |shown: &str, wanted: &str| shown.eq_ignore_ascii_case(wanted);
        let found = (0..names.ports.len())
            .map(PortId::from_index)
            .filter(|&id| is(names.port_name(id).shown(), port));
        let mut ends: Vec<PortEnd> = Vec::new();
        for id in found {
            for party in names.port(id).map_or(&[][..], |info| &info.parties) {
                let wanted = task.is_none_or(|task| is(names.task(party.task).shown(), task));
                let incarnation = names.home(party.task).and_then(|node| self.store().latest(&cell, node));
                if let Some(incarnation) = incarnation.filter(|_| wanted) {
                    ends.push(PortEnd { incarnation: incarnation.id, task: party.task, port: id });
                }
            }
        }
        let capacity = |end: &PortEnd| {
            let view = self
                .store()
                .incarnation(end.incarnation)
                .and_then(|incarnation| incarnation.port(end.task, end.port));
            view.map_or(0, |view| view.capacity)
        };
        let Some(end) = ends.iter().find(|end| capacity(end) > 0).or_else(|| ends.first()).copied() else {
            return Some(format!("this cell has no port {}", crate::name::shown(wanted)));
        };
        self.before = self.screen;
        (self.screen, self.port) = (Screen::Port, Some(end));
        (self.scroll, self.entry) = (0, None);
        None
    }

    fn go_to_node(&mut self, wanted: &str, now: Moment) -> Option<String> {
        let cell = self.cell()?;
        let names = self.store().names(&cell)?.clone();
        let node = names.nodes.iter().position(|name| name.shown().eq_ignore_ascii_case(wanted));
        let task = names.tasks.iter().position(|task| task.name.shown().eq_ignore_ascii_case(wanted));
        let node_id = match (node, task) {
            (Some(node), _) => NodeId::from_index(node),
            (None, Some(task)) => names.home(TaskId::from_index(task))?,
            (None, None) => {
                return Some(format!("this cell has no node or task {}", crate::name::shown(wanted)));
            }
        };
        let incarnation = self.store().latest(&cell, node_id).map(|incarnation| incarnation.id);
        let task = task.filter(|_| node.is_none() && incarnation.is_some()).map(TaskId::from_index);
        self.go_to(Place { node: incarnation.ok_or(node_id), task, port: None }, now);
        None
    }
}
