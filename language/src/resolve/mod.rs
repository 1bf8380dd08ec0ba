//! Name resolution: turns the AST into the HIR. Names become positions, expressions get types (C1..C7).
//!
//! Each fault is reported once: what could not be resolved is left out or *poisoned*, so that uses of it are not reported,
//! too.

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
    /// The cell. Parts of it are missing if a diagnostic is an error.
    pub hir: Hir,
    /// The diagnostics that resolution found.
    pub diagnostics: Vec<Diagnostic>,
}

impl Resolved {
    /// Whether no diagnostic is an error, so that the cell is complete.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.diagnostics.iter().all(|found| found.severity != Severity::Error)
    }
}

/// Resolves the names of a file and types its expressions. `text` is the file's text, which gives the line numbers.
#[must_use]
pub fn resolve(file: &ast::File, text: &str) -> Resolved {
    resolve_rest(file, text, &Lost::default())
}

/// Like [`resolve`], for a file of which parts could not be parsed. Uses of incomplete declarations are not checked.
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

/// Keeps one diagnostic for an unknown name in each declaration of the file, because all its uses have the same cause.
fn said_once(found: &mut Vec<Diagnostic>, lost: &Lost) {
    let mut said = BTreeSet::new();
    found.retain(|found| {
        found.code != UNKNOWN_NAME
            || said.insert((lost.around(found.primary.span).start, found.message.clone()))
    });
}

/// The state of name resolution.
#[derive(Debug, Default)]
struct Resolver<'a> {
    hir: Hir,
    found: Vec<Diagnostic>,
    nodes: Names,
    /// The links: for each pair of nodes, the lower first, the position in [`Hir::links`].
    links: BTreeMap<(NodeId, NodeId), usize>,
    records: Names,
    tasks: Names,
    ports: Names,
    /// The modules and their tasks (D32).
    modules: BTreeMap<&'a str, Vec<TaskId>>,
    /// The names whose declarations are wrong.
    poison: Poison<'a>,
    /// The declarations of the tasks, in the order of [`Hir::tasks`].
    written: Vec<&'a ast::TaskDecl>,
    /// Wrongly declared ports, by position. Their uses are not checked.
    poisoned_ports: BTreeSet<usize>,
    /// Records with unknown fields, by position. Ports and variables of these types are not checked.
    broken_records: BTreeSet<usize>,
    /// Variables of unknown types. Their uses are not checked.
    broken_variables: BTreeSet<(TaskId, &'a str)>,
    /// Ports with an unknown name in their `user_list`, by position. Any task may be such a user.
    guessed_users: BTreeSet<usize>,
    /// Tasks with a `use_port` of an unknown port. Any port may be the one that was meant.
    guessed_uses: BTreeSet<TaskId>,
    /// The work couples as written: standby, primary, and whether they swap roles.
    coupled: Vec<(&'a str, &'a str, bool)>,
    /// The shapes of the actions of each task.
    actions: BTreeMap<(TaskId, String), actions::Shape>,
    /// The ports that carry heartbeats.
    heartbeats: Vec<PortId>,
    /// Whether a couple has no valid heartbeat port.
    heartbeats_unknown: bool,
    /// The parts of the file that could not be parsed.
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
