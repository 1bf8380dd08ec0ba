//! Tables of names, and suggestions for unknown names.

use super::{DUPLICATE, Resolver, UNKNOWN_NAME};
use crate::ast::Name;
use crate::diagnostic::Diagnostic;
use crate::foreign;
use crate::span::Span;
use imrs_protocol::{NodeId, PortId, TaskId};
use std::collections::{BTreeMap, BTreeSet};

/// A table of names: the position of each named thing in its list, and where it is declared.
#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<String, (usize, Span)>);

impl Names {
    pub fn get(&self, name: &str) -> Option<usize> {
        self.0.get(name).map(|&(at, _)| at)
    }

    /// Adds a name. If the name is taken, returns the span of its first declaration.
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

/// Names whose declarations are wrong: uses of these names are not reported.
#[derive(Debug, Default)]
pub(super) struct Poison<'a> {
    pub nodes: BTreeSet<&'a str>,
    pub records: BTreeSet<&'a str>,
    pub tasks: BTreeSet<&'a str>,
    pub ports: BTreeSet<&'a str>,
}

/// The greatest number of known names that a diagnostic lists if none is similar. If more are known, it lists the nearest
/// ones.
const SHOWN: usize = 12;

/// The name among `known` that was probably meant.
pub(super) fn nearest<'n>(name: &str, known: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let lower = name.to_lowercase();
    let far = known.into_iter().map(|other| (strsim::osa_distance(&lower, &other.to_lowercase()), other));
    // One typing error is allowed in a short name, two or three in a long one; case does not count. For a
    // name of one letter no error is allowed, because every other letter would be similar.
    let most = (name.len() / 3).clamp(1, 3).min(name.chars().count().saturating_sub(1));
    let near = far.filter(|&(distance, other)| other != name && distance <= most);
    near.min().map(|(_, other)| other)
}

/// The diagnostic for an unknown name, with a suggestion.
pub(super) fn unknown<'n>(what: &str, name: &Name, known: impl IntoIterator<Item = &'n str>) -> Diagnostic {
    nothing_called(what, name).help(meant(&name.text, known))
}

fn nothing_called(what: &str, name: &Name) -> Diagnostic {
    let message = format!("there is no {what} `{}`", name.text);
    Diagnostic::error(UNKNOWN_NAME, name.span, message).label(format!("no {what} has this name"))
}

/// A hint for an unknown name: a similar name, or the names that exist.
pub(super) fn meant<'n>(name: &str, known: impl IntoIterator<Item = &'n str>) -> String {
    let mut known: Vec<&str> = known.into_iter().filter(|name| !name.starts_with('(')).collect();
    if let Some(other) = nearest(name, known.iter().copied()) {
        return format!("did you mean `{other}`?");
    }
    if known.len() > SHOWN {
        known.sort_by_key(|other| strsim::osa_distance(name, other));
    }
    let first = known.iter().take(SHOWN).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match known.len() {
        0 => String::from("there is none at all: declare it"),
        1..=SHOWN => format!("there is {first}"),
        all => format!("there is {first} and {} more", all - SHOWN),
    }
}

/// The diagnostic for two things with the same name.
pub(super) fn duplicate(what: &str, name: &Name, first: Span) -> Diagnostic {
    Diagnostic::error(DUPLICATE, name.span, format!("two {what} are called `{}`", name.text))
        .label("the second one")
        .also(first, "the first one")
        .help("rename one of them")
}

impl<'a> Resolver<'a> {
    /// The node of this name. Reports an unknown name once, because all its uses have the same cause.
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

    /// The record of this name; `None` if some of its fields are unknown, which was reported at its declaration.
    pub(super) fn record(&mut self, name: &'a Name) -> Option<usize> {
        let at = self.records.get(&name.text);
        if at.is_none() && self.poison.records.insert(&name.text) {
            let plain = crate::foreign::PLAIN_TYPES;
            let found = match foreign::data_type(&name.text) {
                Some(help) => nothing_called("type", name).help(help),
                None => unknown("type", name, self.records.all().chain(plain)),
            };
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

    /// The task of this name, or the tasks of the module of this name (D32).
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
