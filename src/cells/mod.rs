//! The cells that can be run: the built-in ones, whose tasks are Rust programs, and those of the cell language.

pub mod beam_lift;

use crate::cell_file;
use crate::exit::Failure;
use imrs_language::lower::{Action, Behaviour, Script};
use imrs_language::{Unit, compile, render};
use imrs_protocol::script::{Program, Type};
use imrs_protocol::{Cell, CellTable, TaskId};
use imrs_runtime::script::Results;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

/// Where a cell comes from: what a node is told to run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The built-in cell of this name.
    BuiltIn(String),
    /// This text.
    Text {
        /// The name of its file.
        name: String,
        /// The text.
        text: String,
    },
}

/// A cell with what its tasks do.
#[derive(Debug)]
pub struct Loaded {
    /// The cell; its ticks are microseconds.
    pub table: Arc<CellTable>,
    /// By task, its script; none where a Rust program says what the task does.
    pub scripts: Vec<Option<Box<Script>>>,
    source: Option<imrs_language::Source>,
}

/// Reads and compiles the cell of a file.
///
/// # Errors
/// The file cannot be read, or the cell has errors.
pub fn open(path: &Path) -> Result<(Source, Loaded), Failure> {
    let source = cell_file::read(path)?;
    let source = Source::Text { name: cell_file::shown(path), text: source.text().to_owned() };
    let loaded = load(&source)?;
    Ok((source, loaded))
}

/// Compiles a cell.
///
/// # Errors
/// The cell has errors.
pub fn load(source: &Source) -> Result<Loaded, Failure> {
    match source {
        Source::BuiltIn(name) => built_in(name),
        Source::Text { name, text } => of_text(name, text),
    }
}

fn built_in(name: &str) -> Result<Loaded, Failure> {
    let cell =
        if name == beam_lift::NAME { beam_lift::cell() } else { Cell::new(name, imrs_protocol::Ticks(1)) };
    let scripts = cell.tasks.iter().map(|_| None).collect();
    Ok(Loaded { table: table(cell)?, scripts, source: None })
}

fn of_text(name: &str, text: &str) -> Result<Loaded, Failure> {
    let source = imrs_language::Source::new(text.as_bytes()).map_err(|found| said(&[*found], name, None))?;
    let compiled = compile(&source);
    let Some(lowered) = compiled.lower(Unit::Microseconds) else {
        return Err(said(&compiled.diagnostics, name, Some(&source)));
    };
    let script = |behaviour| match behaviour {
        Behaviour::Script(script) => Some(script),
        Behaviour::Extern(_) => None,
    };
    let scripts = lowered.tasks.into_iter().map(script).collect();
    Ok(Loaded { table: table(lowered.cell)?, scripts, source: Some(source) })
}

fn table(cell: Cell) -> Result<Arc<CellTable>, Failure> {
    CellTable::new(cell).map(Arc::new).map_err(|errors| {
        let all: Vec<String> = errors.iter().map(ToString::to_string).collect();
        Failure::Usage(all.join("; "))
    })
}

fn said(found: &[imrs_language::Diagnostic], name: &str, source: Option<&imrs_language::Source>) -> Failure {
    Failure::Cell(render::text(found, name, source, render::Style::Plain).trim_end().to_owned())
}

impl Loaded {
    /// The line, from 1, of the statement that an operation of a task's script belongs to.
    pub fn line(&self, task: TaskId, at: u16) -> Option<usize> {
        let script = self.scripts.get(task.index())?.as_ref()?;
        let span = script.spans.get(usize::from(at))?;
        Some(self.source.as_ref()?.position(span.start).0)
    }

    /// The program of a task's script.
    pub fn program(&self, task: TaskId) -> Option<&Arc<Program>> {
        Some(&self.scripts.get(task.index())?.as_ref()?.program)
    }

    /// The name of an action of a task.
    pub fn action(&self, task: TaskId, action: u16) -> &str {
        let script = self.scripts.get(task.index()).and_then(Option::as_ref);
        let action = script.and_then(|script| script.actions.get(usize::from(action)));
        action.map_or("?", |action| action.name.as_str())
    }

    /// The names of all actions.
    pub fn actions(&self) -> impl Iterator<Item = &str> {
        self.all_actions().map(|action| action.name.as_str())
    }

    /// What simulated actions give: what is declared, else what the cell compares it with, else something small.
    pub fn results(&self) -> Vec<Results> {
        let mut results: BTreeMap<&str, RangeInclusive<i32>> = BTreeMap::new();
        for action in self.all_actions() {
            if let Some(range) = range(action) {
                let known = results.entry(&action.name).or_insert_with(|| range.clone());
                *known = *known.start().min(range.start())..=*known.end().max(range.end());
            }
        }
        results.into_iter().map(|(name, range)| Results { name: name.into(), range }).collect()
    }

    fn all_actions(&self) -> impl Iterator<Item = &Action> {
        self.scripts.iter().flatten().flat_map(|script| &script.actions)
    }
}

fn range(action: &Action) -> Option<RangeInclusive<i32>> {
    let compared = || Some((*action.values.iter().min()?, *action.values.iter().max()?));
    let of_type = || match action.result? {
        Type::Bool => Some((0, 1)),
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word => Some((0, 100)),
        // By its bits: 0 alone.
        Type::Real => Some((0, 0)),
    };
    let (least, most) = action.range.or_else(compared).or_else(of_type)?;
    let (least, most) = (i32::try_from(least).ok()?, i32::try_from(most).ok()?);
    (least <= most).then_some(least..=most)
}
