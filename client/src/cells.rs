//! Compiles cells of the cell language for the nodes that run them.

use crate::cell_file::{self, CellFileError};
use imrs_language::lower::{Action, Address, Behaviour, Check, Script};
use imrs_language::{Diagnostic, Options, Source, Unit, compile_with, render};
use imrs_protocol::script::{Program, Type};
use imrs_protocol::{Cell, CellTable, TaskId};
use imrs_runtime::record::statements;
use imrs_runtime::script::{Give, Results};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Why a cell cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CellError {
    /// The cell's file cannot be read.
    #[error(transparent)]
    File(#[from] CellFileError),
    /// The cell has errors: the diagnostics of the compiler, as text.
    #[error("{0}")]
    Text(String),
}

/// A compiled cell, with the scripts of its tasks.
#[derive(Debug)]
pub struct Loaded {
    /// The cell; its ticks are microseconds.
    pub table: Arc<CellTable>,
    /// The script of each task; `None` for an extern task, whose body is a Rust program.
    pub scripts: Vec<Option<Box<Script>>>,
    /// The declared address of each node.
    pub addresses: Vec<Address>,
    /// The checks of the cell.
    pub checks: Vec<Check>,
    /// The cell's text.
    pub source: Source,
}

/// Reads and compiles the cell of a file. `paper` is explained at [`Options`].
///
/// # Errors
/// [`CellError`].
pub fn open(path: &Path, paper: bool) -> Result<Loaded, CellError> {
    compile(cell_file::read(path)?, &cell_file::shown(path), paper)
}

/// Compiles the cell of a text. Diagnostics show `name` as its file.
///
/// # Errors
/// [`CellError::Text`].
pub fn load(name: &str, text: &str, paper: bool) -> Result<Loaded, CellError> {
    let source = Source::new(text.as_bytes()).map_err(|found| said(&[*found], name, None))?;
    compile(source, name, paper)
}

fn compile(source: Source, name: &str, paper: bool) -> Result<Loaded, CellError> {
    let compiled = compile_with(&source, Options { paper });
    let Some(lowered) = compiled.lower(Unit::Microseconds) else {
        return Err(said(&compiled.diagnostics, name, Some(&source)));
    };
    let script = |behaviour| match behaviour {
        Behaviour::Script(script) => Some(script),
        Behaviour::Extern(_) => None,
    };
    let scripts = lowered.tasks.into_iter().map(script).collect();
    let (addresses, checks) = (lowered.addresses, lowered.checks);
    Ok(Loaded { table: table(lowered.cell)?, scripts, addresses, checks, source })
}

fn table(cell: Cell) -> Result<Arc<CellTable>, CellError> {
    CellTable::new(cell).map(Arc::new).map_err(|errors| {
        let all: Vec<String> = errors.iter().map(ToString::to_string).collect();
        CellError::Text(all.join("; "))
    })
}

fn said(found: &[Diagnostic], name: &str, source: Option<&Source>) -> CellError {
    CellError::Text(render::text(found, name, source, render::Style::Plain).trim_end().to_owned())
}

impl Loaded {
    /// The script of a task; `None` for an extern task.
    #[must_use]
    pub fn script(&self, task: TaskId) -> Option<&Script> {
        self.scripts.get(task.index())?.as_deref()
    }

    /// The program of a task's script.
    #[must_use]
    pub fn program(&self, task: TaskId) -> Option<&Arc<Program>> {
        Some(&self.script(task)?.program)
    }

    /// The digest of the scripts of these tasks; zero if none of them has a script.
    pub fn statements_of(&self, tasks: impl Iterator<Item = TaskId>) -> u32 {
        statements(tasks.filter_map(|task| Some((task, &**self.program(task)?))))
    }

    /// The digest of the scripts of all nodes; zero if there are no scripts. Nodes with different digests refuse each
    /// other. An extern task does not enter the digest, so the cells of both nodes must declare the task `extern`.
    #[must_use]
    pub fn all_statements(&self) -> u32 {
        self.statements_of((0..self.scripts.len()).map(TaskId::from_index))
    }

    /// The names of all actions of the cell.
    pub fn actions(&self) -> impl Iterator<Item = &str> {
        self.all_actions().map(|action| action.name.as_str())
    }

    /// The tasks that may run an action of this name.
    pub fn tasks_with_action(&self, name: &str) -> impl Iterator<Item = TaskId> {
        let has_it = move |script: &Script| script.actions.iter().any(|action| action.name == name);
        let scripts = self.scripts.iter().enumerate();
        scripts.filter_map(move |(at, script)| {
            script.as_ref().filter(|script| has_it(script)).map(|_| TaskId::from_index(at))
        })
    }

    /// For each action, the range from which a simulated result is drawn: the declared range if there is one; otherwise
    /// the range of the values with which the cell compares the result; without such values, a small default range.
    #[must_use]
    pub fn results(&self) -> Vec<Results> {
        let mut results: BTreeMap<&str, (i64, i64, bool)> = BTreeMap::new();
        for action in self.all_actions() {
            if let Some((least, most)) = range(action) {
                let real = action.result == Some(Type::Real);
                let known = results.entry(&action.name).or_insert((least, most, real));
                // Statements with the same action share the intersection of their ranges. If the ranges do not overlap,
                // they share the smallest range that covers all of them.
                let common = (known.0.max(least), known.1.min(most));
                let all = (known.0.min(least), known.1.max(most));
                let (least, most) = if common.0 <= common.1 { common } else { all };
                *known = (least, most, real);
            }
        }
        let of = |(name, (least, most, real)): (&str, (i64, i64, bool))| {
            #[expect(clippy::cast_precision_loss, reason = "the nearest real is meant")]
            let give = if real {
                Give::Real(least as f32, most as f32)
            } else {
                Give::Whole(i32::try_from(least).ok()?, i32::try_from(most).ok()?)
            };
            Some(Results { name: name.into(), give })
        };
        results.into_iter().filter_map(of).collect()
    }

    fn all_actions(&self) -> impl Iterator<Item = &Action> {
        self.scripts.iter().flatten().flat_map(|script| &script.actions)
    }
}

/// The range of an action's results: the least and the greatest.
fn range(action: &Action) -> Option<(i64, i64)> {
    // The bounds for a `real` are the whole numbers below and above its value.
    let around = |&value: &i64| match action.result {
        Some(Type::Real) => {
            let x = f32::from_bits(i32::try_from(value).unwrap_or(0).cast_unsigned());
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a whole number, or the last one of that side"
            )]
            let ends = (x.floor() as i64, x.ceil() as i64);
            ends
        }
        Some(_) | None => (value, value),
    };
    let compared = || {
        let values = || action.values.iter().map(around);
        Some((values().map(|(low, _)| low).min()?, values().map(|(_, high)| high).max()?))
    };
    let of_type = || match action.result? {
        Type::Bool => Some((0, 1)),
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word | Type::Real => Some((0, 100)),
    };
    action.range.or_else(compared).or_else(of_type).filter(|(least, most)| least <= most)
}
