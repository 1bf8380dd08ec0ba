//! Tables of names, and what may have been meant by a name that is in none.

use super::{DUPLICATE, Resolver, UNKNOWN_NAME};
use crate::ast::Name;
use crate::diagnostic::Diagnostic;
use crate::span::Span;
use imrs_protocol::{NodeId, PortId, TaskId};
use std::collections::{BTreeMap, BTreeSet};

/// Names and the positions of what they name.
#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<String, (usize, Span)>);

impl Names {
    pub fn get(&self, name: &str) -> Option<usize> {
        self.0.get(name).map(|&(at, _)| at)
    }

    /// Adds a name; where it is taken, gives the place of the first one.
    pub fn add(&mut self, name: &Name, at: usize) -> Result<(), Span> {
        if let Some(&(_, first)) = self.0.get(&name.text) {
            return Err(first);
        }
        self.0.insert(name.text.clone(), (at, name.span));
        Ok(())
    }

    pub fn all(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}

/// Names of things that are declared, but wrongly: using them is no second fault.
#[derive(Debug, Default)]
pub(super) struct Poison<'a> {
    pub nodes: BTreeSet<&'a str>,
    pub records: BTreeSet<&'a str>,
    pub tasks: BTreeSet<&'a str>,
    pub ports: BTreeSet<&'a str>,
}

/// So many names are listed where none is near.
const SHOWN: usize = 6;

/// The name among `known` that was probably meant.
pub(super) fn nearest<'n>(name: &str, known: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let lower = name.to_lowercase();
    let far = known.into_iter().map(|other| (strsim::osa_distance(&lower, &other.to_lowercase()), other));
    // A slip in a short name, two or three in a long one; the case of letters is none.
    // Of a name of one letter every other one is a slip.
    let most = (name.len() / 3).clamp(1, 3).min(name.chars().count().saturating_sub(1));
    let near = far.filter(|&(distance, other)| other != name && distance <= most);
    near.min().map(|(_, other)| other)
}

/// `unknown task `armX``, and what may have been meant.
pub(super) fn unknown<'n>(what: &str, name: &Name, known: impl IntoIterator<Item = &'n str>) -> Diagnostic {
    let message = format!("there is no {what} `{}`", name.text);
    let found = Diagnostic::error(UNKNOWN_NAME, name.span, message).label(format!("no {what} has this name"));
    found.help(meant(&name.text, known))
}

/// What may have been meant, or what there is.
pub(super) fn meant<'n>(name: &str, known: impl IntoIterator<Item = &'n str>) -> String {
    let known: Vec<&str> = known.into_iter().filter(|name| !name.starts_with('(')).collect();
    if let Some(other) = nearest(name, known.iter().copied()) {
        return format!("did you mean `{other}`?");
    }
    let first = known.iter().take(SHOWN).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match known.len() {
        0 => String::from("there is none at all: declare it"),
        1..=SHOWN => format!("there is {first}"),
        all => format!("there is {first} and {} more", all - SHOWN),
    }
}

/// Two things of one name.
pub(super) fn duplicate(what: &str, name: &Name, first: Span) -> Diagnostic {
    Diagnostic::error(DUPLICATE, name.span, format!("two {what} are called `{}`", name.text))
        .label("the second one")
        .also(first, "the first one")
        .help("rename one of them")
}

impl<'a> Resolver<'a> {
    /// A name that is unknown is said once: its other uses mean the same thing.
    pub(super) fn node(&mut self, name: &'a Name) -> Option<NodeId> {
        if let Some(at) = self.nodes.get(&name.text) {
            return Some(NodeId::from_index(at));
        }
        if self.poison.nodes.insert(&name.text) {
            let found = unknown("node", name, self.nodes.all());
            self.report(found);
        }
        None
    }

    /// A record; none where not all of its fields are known, which is said where it is declared.
    pub(super) fn record(&mut self, name: &'a Name) -> Option<usize> {
        let at = self.records.get(&name.text);
        if at.is_none() && self.poison.records.insert(&name.text) {
            let plain = ["bool", "int8", "int16", "int32", "integer", "word", "real"];
            let found = unknown("type", name, self.records.all().chain(plain));
            self.report(found);
        }
        at.filter(|at| !self.broken_records.contains(at))
    }

    pub(super) fn task(&mut self, name: &'a Name) -> Option<TaskId> {
        if let Some(at) = self.tasks.get(&name.text) {
            return Some(TaskId::from_index(at));
        }
        if self.poison.tasks.insert(&name.text) {
            let found = unknown("task", name, self.tasks.all());
            self.report(found);
        }
        None
    }

    pub(super) fn port(&mut self, name: &'a Name) -> Option<PortId> {
        if let Some(at) = self.ports.get(&name.text) {
            return Some(PortId::from_index(at));
        }
        if self.poison.ports.insert(&name.text) {
            let found = unknown("port", name, self.ports.all());
            self.report(found);
        }
        None
    }

    /// The tasks that a name of a task or a module stands for (D32).
    pub(super) fn tasks_or_module(&mut self, name: &'a Name) -> Vec<TaskId> {
        if let Some(at) = self.tasks.get(&name.text) {
            return vec![TaskId::from_index(at)];
        }
        if let Some(tasks) = self.modules.get(name.text.as_str()) {
            return tasks.clone();
        }
        if self.poison.tasks.insert(&name.text) {
            let found = unknown("task or module", name, self.tasks.all().chain(self.modules.keys().copied()));
            self.report(found);
        }
        Vec::new()
    }
}
