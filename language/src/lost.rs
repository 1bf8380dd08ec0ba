//! Records which parts of a file could not be parsed, and drops later findings that may only follow from these lost parts.
//!
//! Names, types and times of the other parts are checked nevertheless. A finding is dropped if it reports something as
//! missing that a lost part may contain.

use crate::codes::{
    ACTION, ACTS_EARLY, ARGUMENTS, DEADLINE, DISAGREE, DUPLICATE, HANDLERS, INTERVAL, LEASE_TOO_SHORT,
    NEVER_ANSWERED, NEVER_COMES, NEVER_RECEIVED, NO_LINK, NO_TIME_OUT, OPTION, ORDER, RATE, RING,
    SHORT_TIME_OUT, STATEMENT, TAKEOVER_TOO_SOON, TOO_LONG, TOO_MANY, TWICE, TWO_OWNERS, TYPES, UNKNOWN_NAME,
    USAGES, WAITFOR_ORDER, WRAPS,
};
use crate::diagnostic::{Diagnostic, Severity};
use crate::source::Source;
use crate::span::Span;
use std::collections::BTreeSet;

/// The parts of a file that could not be parsed: the lost parts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lost {
    /// The spans of lost lines, blocks and whole declarations.
    pub spans: Vec<Span>,
    /// The offsets of the file's declarations, parsed or not, in the order of the text, and whether each may change routes
    /// between nodes.
    pub items: Vec<(u32, bool)>,
    /// Whether a lost part lies outside of tasks and records, or is itself a whole task or record.
    pub outside: bool,
    /// Whether so much is lost that nothing else can be checked.
    pub all: bool,
}

/// The declarations with errors and the lost parts of a file. Findings that depend on them are in doubt.
pub(crate) struct Doubts<'s> {
    lost: &'s Lost,
    source: &'s Source,
    /// The words in the lost parts: each of these names may be declared there.
    names: BTreeSet<&'s str>,
    /// The declarations that have an error, by position in the text.
    items: BTreeSet<usize>,
}

impl Lost {
    /// Whether a lost part overlaps the span.
    pub fn touches(&self, span: Span) -> bool {
        self.spans.iter().any(|lost| lost.start < span.end && span.start < lost.end)
    }

    /// The number of the declaration around a span, from 1; 0 if the span is in front of the first declaration.
    fn item(&self, span: Span) -> usize {
        self.items.partition_point(|(begin, _)| *begin <= span.start)
    }

    /// The declaration of the file around a span, from its first word up to the next declaration.
    pub fn around(&self, span: Span) -> Span {
        let at = self.item(span);
        let begin = |at: usize| self.items.get(at).map(|(begin, _)| *begin);
        Span {
            start: at.checked_sub(1).and_then(begin).unwrap_or_default(),
            end: begin(at).unwrap_or(u32::MAX),
        }
    }
}

impl<'s> Doubts<'s> {
    /// The doubts that the syntax errors of a file cause.
    pub fn new(lost: &'s Lost, source: &'s Source, found: &[Diagnostic]) -> Self {
        let texts = lost.spans.iter().map(|span| source.slice(*span));
        let names = texts.flat_map(words).collect();
        let mut doubts = Self { lost, source, names, items: BTreeSet::new() };
        doubts.add(found);
        doubts
    }

    /// Adds the declarations at which these errors point.
    pub fn add(&mut self, found: &[Diagnostic]) {
        let errors = found.iter().filter(|found| found.severity == Severity::Error);
        self.items.extend(errors.flat_map(places).map(|span| self.lost.item(span)));
    }

    /// Whether a finding about names and types holds, whatever the lost parts contain.
    pub fn keeps_name(&self, found: &Diagnostic) -> bool {
        if self.lost.touches(found.primary.span) {
            return false;
        }
        match found.code {
            UNKNOWN_NAME => {
                !words(self.source.slice(found.primary.span)).any(|name| self.names.contains(name))
            }
            DUPLICATE | TWO_OWNERS | USAGES | DISAGREE | ARGUMENTS | TOO_LONG | OPTION | TYPES | ACTION
            | HANDLERS | ORDER | TWICE | TOO_MANY | INTERVAL => true,
            // The other findings report something missing, which a lost part may contain.
            _ => !self.in_doubt(found) && !self.lost.outside,
        }
    }

    /// Whether an error of behaviour or time depends only on declarations without errors.
    pub fn keeps_behaviour(&self, found: &Diagnostic) -> bool {
        let known = match found.code {
            NEVER_COMES | RING | WAITFOR_ORDER | NEVER_RECEIVED | SHORT_TIME_OUT | NO_TIME_OUT
            | ACTS_EARLY | WRAPS | STATEMENT => true,
            // These findings depend on routes, which an unknown link may change.
            DEADLINE | RATE | NO_LINK | TAKEOVER_TOO_SOON | LEASE_TOO_SHORT => !self.ways_in_doubt(),
            NEVER_ANSWERED => self.lost.spans.is_empty(),
            _ => false,
        };
        known && !self.in_doubt(found)
    }

    /// Whether a link may be missing or wrong.
    fn ways_in_doubt(&self) -> bool {
        let shapes = |item: &usize| {
            item.checked_sub(1).and_then(|at| self.lost.items.get(at)).is_none_or(|(_, shapes)| *shapes)
        };
        self.items.iter().any(shapes)
    }

    fn in_doubt(&self, found: &Diagnostic) -> bool {
        places(found).any(|span| self.items.contains(&self.lost.item(span)))
    }
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|word| !word.is_empty())
}

fn places(found: &Diagnostic) -> impl Iterator<Item = Span> + '_ {
    std::iter::once(&found.primary).chain(&found.secondary).map(|label| label.span)
}
