//! From what is written to what is meant: names become positions, expressions get types (C1..C7).
//!
//! One fault is said once: what could not be resolved is left out or *poisoned*, so that its uses are not faults too.

mod actions;
mod cell;
mod checks;
mod couples;
mod expr;
mod handlers;
mod messages;
mod names;
mod options;
mod ports;
mod replies;
mod scope;
mod sends;
mod statements;
mod tasks;
mod users;
mod words;

pub(crate) use expr::word;
pub(crate) use scope::after;

use crate::ast;
use crate::codes::{
    ACTION, ARGUMENTS, COUPLE, DISAGREE, DUPLICATE, HANDLERS, HIDES, INTERVAL, MISSING, NO_USE_PORT,
    NOT_LISTED, OPTION, ORDER, STATEMENT, TAKEOVER, TIMERS, TOO_LONG, TOO_MANY, TWICE, TWO_OWNERS, TYPES,
    UNKNOWN_NAME, USAGES,
};
use crate::diagnostic::{Diagnostic, Severity};
use crate::hir::Hir;
use crate::lost::Lost;
use imrs_protocol::{NodeId, PortId, TaskId};
use names::{Names, Poison};
use std::collections::{BTreeMap, BTreeSet};

/// A cell with its names resolved, as far as that is possible.
#[derive(Clone, Debug)]
pub struct Resolved {
    /// The cell. Where a diagnostic is an error, parts of it are missing.
    pub hir: Hir,
    /// What is wrong with it.
    pub diagnostics: Vec<Diagnostic>,
}

impl Resolved {
    /// Whether the cell is whole.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.diagnostics.iter().all(|found| found.severity != Severity::Error)
    }
}

/// Resolves the names of a file and types its expressions. `text` is the file's text, for its lines.
#[must_use]
pub fn resolve(file: &ast::File, text: &str) -> Resolved {
    resolve_rest(file, text, &Lost::default())
}

/// The same of a file of which parts could not be read: what is declared half is not looked at where it is used.
pub(crate) fn resolve_rest(file: &ast::File, text: &str, lost: &Lost) -> Resolved {
    let mut resolver = Resolver { lost: lost.clone(), ..Resolver::default() };
    let ends = text.bytes().enumerate().filter(|&(_, byte)| byte == b'\n');
    let lines = std::iter::once(0).chain(ends.map(|(at, _)| u32::try_from(at + 1).unwrap_or(u32::MAX)));
    resolver.hir.lines = lines.collect();
    resolver.file(file);
    let Resolver { hir, mut found, .. } = resolver;
    found.sort_by_key(|diagnostic| diagnostic.primary.span);
    said_once(&mut found, lost);
    Resolved { hir, diagnostics: found }
}

/// A name that is unknown is said once in a declaration of the file: its other uses mean the same thing.
fn said_once(found: &mut Vec<Diagnostic>, lost: &Lost) {
    let mut said = BTreeSet::new();
    found.retain(|found| {
        found.code != UNKNOWN_NAME
            || said.insert((lost.around(found.primary.span).start, found.message.clone()))
    });
}

/// What is known while a file is resolved.
#[derive(Debug, Default)]
struct Resolver<'a> {
    hir: Hir,
    found: Vec<Diagnostic>,
    nodes: Names,
    /// The links by their ends, the lower one first: positions in [`Hir::links`].
    links: BTreeMap<(NodeId, NodeId), usize>,
    records: Names,
    tasks: Names,
    ports: Names,
    /// The modules and their tasks (D32).
    modules: BTreeMap<&'a str, Vec<TaskId>>,
    /// What is declared, but could not be resolved.
    poison: Poison<'a>,
    /// The tasks in the order of [`Hir::tasks`], as written.
    written: Vec<&'a ast::TaskDecl>,
    /// Ports that are declared wrongly, by position: their uses are not looked at.
    poisoned_ports: BTreeSet<usize>,
    /// Records of which not all fields are known, by position: what holds them is not looked at.
    broken_records: BTreeSet<usize>,
    /// Variables of types that are not known: their uses are not looked at.
    broken_variables: BTreeSet<(TaskId, &'a str)>,
    /// Ports whose `user_list` names somebody unknown, by position: any task may be meant.
    guessed_users: BTreeSet<usize>,
    /// Tasks with a `use_port` of an unknown port: any port may be meant.
    guessed_uses: BTreeSet<TaskId>,
    /// Who stands by for whom, as written, and whether the roles are exchanged.
    coupled: Vec<(&'a str, &'a str, bool)>,
    /// The shapes of the actions of each task.
    actions: BTreeMap<(TaskId, String), actions::Shape>,
    /// The ports that carry the beats of couples.
    beats: Vec<PortId>,
    /// Whether there is a couple whose beats have no proper port.
    beats_unknown: bool,
    /// What could not be read.
    lost: Lost,
}

impl<'a> Resolver<'a> {
    fn file(&mut self, file: &'a ast::File) {
        if self.has_too_many_nodes(file) {
            return;
        }
        self.cell(file);
        self.declare_tasks(file);
        self.declare_ports();
        self.use_ports();
        self.couples(file);
        self.behaviours();
        self.guards();
        self.faults(file);
        self.checks(file);
    }

    fn report(&mut self, diagnostic: Diagnostic) {
        self.found.push(diagnostic);
    }
}
