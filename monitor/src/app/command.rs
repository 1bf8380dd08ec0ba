//! The command line that opens with `:`.

use super::complete::fuzzy;
use super::{App, Effect, PortEnd, Screen};
use crate::clock::Moment;
use crate::options::Endpoint;
use crate::store::health::{Place, codes};
use crate::theme::Theme;
use imrs_protocol::{NodeId, PortId, TaskId};

/// The commands: what the user types, and what it does.
pub const COMMANDS: [(&str, &str); 6] = [
    ("connect unix:PATH|tcp:HOST:PORT", "attach to one more node"),
    ("port NAME", "the queue of a port (also TASK.PORT)"),
    ("node NAME", "a node, or a task, in the overview"),
    ("explain COLUMN|CODE", "what a column shows, or what a finding means"),
    ("theme NAME", "how the screen looks"),
    ("quit", "quit"),
];

impl App {
    /// Carries out a command.
    pub(super) fn run(&mut self, text: &str, now: Moment) -> Effect {
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
            ("explain", word) => self.explain_word(word),
            ("theme", name) => match theme(name) {
                Some(theme) => {
                    (self.theme, self.told) = (self.theme.changed_to(theme), None);
                    return Effect::Theme;
                }
                None => Some(no_theme()),
            },
            _ => {
                let known = COMMANDS.map(|(usage, _)| format!(":{usage}")).join("  ");
                Some(format!("no such command; there are {known}"))
            }
        };
        Effect::Draw
    }

    /// The words that may follow the text `before` in a command.
    pub(super) fn words_of_command(&self, before: &str) -> Vec<String> {
        match before.split_whitespace().next() {
            None => {
                COMMANDS.iter().filter_map(|(usage, _)| usage.split(' ').next()).map(str::to_owned).collect()
            }
            Some("port") => self.names_of_ports(),
            Some("node" | "task") => self.names_of_places(),
            Some("explain") => self.words_explained(),
            Some("theme") => Theme::names().into_iter().map(str::to_owned).collect(),
            Some(_) => Vec::new(),
        }
    }

    /// What is wrong with the command that is being typed, so far.
    pub(super) fn slip_of_command(&self, text: &str) -> Option<String> {
        let (word, rest) = text
            .trim_start()
            .split_once(' ')
            .map_or((text.trim(), None), |(word, rest)| (word, Some(rest.trim())));
        match (word, rest.unwrap_or_default()) {
            (_, "") => {
                let words = self.words_of_command("");
                let is_begun =
                    words.iter().any(|known| known.starts_with(word)) || matches!(word, "q" | "task");
                (!is_begun).then(|| format!("no such command; there are {}", words.join(", ")))
            }
            ("connect", address) => address.parse::<Endpoint>().err().map(|error| error.to_string()),
            ("port", name) => {
                nearest(name, self.names_of_ports()).is_none().then(|| self.not_there("port", name))
            }
            ("node" | "task", name) => {
                nearest(name, self.names_of_places()).is_none().then(|| self.not_there("node or task", name))
            }
            ("explain", word) => nearest(word, self.words_explained()).is_none().then(|| no_word(word)),
            ("theme", name) => theme(name).is_none().then(no_theme),
            _ => None,
        }
    }

    /// The words that can be explained: the columns of the shown screen, and the codes of findings.
    pub(super) fn words_explained(&self) -> Vec<String> {
        let columns = crate::view::explained_columns(self.screen).iter().map(|(name, _)| *name);
        columns.chain(codes::ALL.iter().map(|lint| lint.code)).map(str::to_owned).collect()
    }

    /// Explains a column of the shown screen on the bottom line, or opens the page of a code.
    fn explain_word(&mut self, wanted: &str) -> Option<String> {
        let Some(word) = nearest(wanted, self.words_explained()) else { return Some(no_word(wanted)) };
        if let Some(text) = crate::view::explain_column(self.screen, &word) {
            return Some(text);
        }
        self.open_page(codes::find(&word)?.code);
        None
    }

    /// Shows the queue of a port at the task that receives through it.
    fn go_to_port(&mut self, wanted: &str) -> Option<String> {
        let Some(found) = nearest(wanted, self.names_of_ports()) else {
            return Some(self.not_there("port", wanted));
        };
        let (task, port) = found.rsplit_once('.').map_or((None, &*found), |(task, port)| (Some(task), port));
        let cell = self.cell()?;
        let names = self.store().names(&cell)?.clone();
        let is = |shown: &str, wanted: &str| shown == wanted;
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
            return Some(self.not_there("port", wanted));
        };
        self.before = self.screen;
        (self.screen, self.port) = (Screen::Port, Some(end));
        (self.scroll, self.entry) = (0, None);
        None
    }

    fn go_to_node(&mut self, wanted: &str, now: Moment) -> Option<String> {
        let Some(found) = nearest(wanted, self.names_of_places()) else {
            return Some(self.not_there("node or task", wanted));
        };
        let cell = self.cell()?;
        let names = self.store().names(&cell)?.clone();
        let node = names.nodes.iter().position(|name| name.shown() == found);
        let task = names.tasks.iter().position(|task| task.name.shown() == found);
        let node_id = match (node, task) {
            (Some(node), _) => NodeId::from_index(node),
            (None, Some(task)) => names.home(TaskId::from_index(task))?,
            (None, None) => {
                return Some(self.not_there("node or task", wanted));
            }
        };
        let incarnation = self.store().latest(&cell, node_id).map(|incarnation| incarnation.id);
        let task = task.filter(|_| node.is_none() && incarnation.is_some()).map(TaskId::from_index);
        self.go_to(Place { node: incarnation.ok_or(node_id), task, port: None }, now);
        None
    }

    /// Why a port, a node or a task of this name cannot be shown.
    fn not_there(&self, what: &str, wanted: &str) -> String {
        if self.cell().and_then(|cell| self.store().names(&cell)).is_none() {
            return "no node has reported yet what is in this cell".to_owned();
        }
        format!("this cell has no {what} {}", crate::name::shown(wanted))
    }
}

fn no_word(wanted: &str) -> String {
    format!("this screen has no column, and `imrs explain` no page, {}", crate::name::shown(wanted))
}

/// Finds the name that the user means: this name in any case, or the first name that contains its letters in this order.
fn nearest(wanted: &str, names: Vec<String>) -> Option<String> {
    let exact = names.iter().find(|name| name.eq_ignore_ascii_case(wanted)).cloned();
    exact.or_else(|| fuzzy(wanted, names).into_iter().next()).filter(|_| !wanted.is_empty())
}

/// The theme that the user means.
fn theme(wanted: &str) -> Option<Theme> {
    Theme::named(&nearest(wanted, Theme::names().into_iter().map(str::to_owned).collect())?)
}

fn no_theme() -> String {
    format!("there is no such theme; there are {}", Theme::names().join(", "))
}
