//! Scopes: the variables of a task, and the variables of a handler, which hide those of the task.

use super::names::meant;
use crate::ast::{Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::{Destination, Record};
use crate::resolve::{TYPES, UNKNOWN_NAME};
use crate::span::Span;
use imrs_protocol::TimeId;
use imrs_protocol::script::{Slot, Type};
use std::collections::BTreeMap;

/// The meaning of a variable's name.
#[derive(Clone, Copy, Debug)]
pub(super) enum Entity {
    /// A plain variable.
    Plain(Slot, Type),
    /// A record: its first field has the slot `first`, the other fields follow.
    Record { record: usize, first: Slot },
    /// The name of a timer.
    Timer(TimeId),
    /// A variable of an unknown type.
    Unknown,
}

/// The variables in scope.
#[derive(Clone, Debug, Default)]
pub(super) struct Scope<'a> {
    names: BTreeMap<&'a str, (Entity, Span)>,
    /// The spans of names that were declared twice.
    twice: Vec<Span>,
}

impl<'a> Scope<'a> {
    /// Adds a name. If the name is taken, returns the span of its first declaration.
    pub fn add(&mut self, name: &'a Name, entity: Entity) -> Result<(), Span> {
        if let Some(&(_, first)) = self.names.get(name.text.as_str()) {
            self.twice.push(name.span);
            return Err(first);
        }
        self.names.insert(&name.text, (entity, name.span));
        Ok(())
    }

    /// Adds a variable of a handler. It hides a variable of the task with the same name.
    pub fn shadow(&mut self, name: &'a Name, entity: Entity) {
        self.names.insert(&name.text, (entity, name.span));
    }

    pub fn get(&self, name: &str) -> Option<Entity> {
        self.names.get(name).map(|&(entity, _)| entity)
    }

    /// The span of a name's declaration.
    pub fn declared(&self, name: &str) -> Option<Span> {
        self.names.get(name).map(|&(_, span)| span)
    }

    pub fn has(&self, name: &str) -> bool {
        self.names.contains_key(name)
    }

    pub fn is_twice(&self, span: Span) -> bool {
        self.twice.contains(&span)
    }

    pub fn all(&self) -> impl Iterator<Item = &'a str> {
        self.names.keys().copied()
    }

    /// What a place in a statement means: one variable, the fields of a record, or a timer.
    ///
    /// # Errors
    /// The diagnostic; `None` if the fault was reported before.
    pub fn place(&self, place: &Place, records: &[Record]) -> Result<Found, Option<Box<Diagnostic>>> {
        let [name, rest @ ..] = &place.path[..] else { return Err(None) };
        let Some(entity) = self.get(&name.text) else {
            return Err(Some(Box::new(super::names::unknown("variable", name, self.all()))));
        };
        match (entity, rest) {
            (Entity::Unknown, _) => Err(None),
            (Entity::Plain(slot, of), []) => Ok(Found::One(Destination { slot, of })),
            (Entity::Timer(timer), []) => Ok(Found::Timer(timer)),
            (Entity::Record { record, first }, []) => {
                let fields = records.get(record).map_or(&[][..], |record| &record.fields);
                let places = fields.iter().enumerate();
                Ok(Found::Whole(
                    places.map(|(i, f)| Destination { slot: after(first, i), of: f.of }).collect(),
                ))
            }
            (Entity::Record { record, first }, [field]) => {
                let Some(record) = records.get(record) else { return Err(None) };
                match record.fields.iter().position(|other| other.name == field.text) {
                    Some(at) => {
                        let of = record.fields[at].of;
                        Ok(Found::One(Destination { slot: after(first, at), of }))
                    }
                    None => Err(Some(Box::new(no_field(record, field)))),
                }
            }
            (Entity::Plain(..) | Entity::Timer(_), [field, ..]) | (Entity::Record { .. }, [_, field, ..]) => {
                let message = format!("`{}` is not a record", path(&place.path[..place.path.len() - 1]));
                let found = Diagnostic::error(TYPES, field.span, message)
                    .label("it has no fields")
                    .also(name.span, "a plain value")
                    .help("leave the field out, or declare the variable with a record's type");
                Err(Some(Box::new(found)))
            }
        }
    }
}

/// What a place in a statement means.
#[derive(Clone, Debug)]
pub(super) enum Found {
    One(Destination),
    Whole(Vec<Destination>),
    Timer(TimeId),
}

fn no_field(record: &Record, field: &Name) -> Diagnostic {
    let message = format!("record `{}` has no field `{}`", record.name, field.text);
    let found = Diagnostic::error(UNKNOWN_NAME, field.span, message)
        .label("no such field")
        .also(record.span, "the record");
    found.help(meant(&field.text, record.fields.iter().map(|field| field.name.as_str())))
}

/// The names of a place as text: `me.height`.
pub(super) fn path(names: &[Name]) -> String {
    let names: Vec<&str> = names.iter().map(|name| name.text.as_str()).collect();
    names.join(".")
}

/// The slot of a task's variable.
pub(super) fn slot(at: usize) -> Slot {
    Slot::Task(u16::try_from(at).unwrap_or(u16::MAX))
}

/// The slot that lies `by` positions behind `first`.
pub(crate) fn after(first: Slot, by: usize) -> Slot {
    let by = u16::try_from(by).unwrap_or(u16::MAX);
    match first {
        Slot::Task(at) => Slot::Task(at.saturating_add(by)),
        Slot::Local(at) => Slot::Local(at.saturating_add(by)),
    }
}
