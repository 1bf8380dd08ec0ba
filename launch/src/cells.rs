//! Compiles cells of the cell language, and finds the names and lines that texts for people need.

use imrs_client::cell_file;
use imrs_client::cells::{self, CellError};
use imrs_language::Span;
use imrs_language::lower::{Action, CheckKind};
use imrs_protocol::script::{Op, Predicate, Program, Reading, Term, Type, Variable};
use imrs_protocol::{NodeId, PortId, TaskId};
use serde::{Deserialize, Serialize};
use std::ops::Deref;
use std::path::Path;

/// The text of a cell, in the form in which the launcher sends it to each node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// The name of the cell's file.
    pub name: String,
    /// The text of the cell.
    pub text: String,
    /// Whether the cell is compiled by the paper's own rules (`--paper`).
    pub paper: bool,
}

/// A compiled cell, as a robot's program also has it. Its methods add names and line numbers, for texts that people read.
#[derive(Debug)]
pub struct Loaded(cells::Loaded);

impl Deref for Loaded {
    type Target = cells::Loaded;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

/// Reads and compiles the cell of a file. `paper` is explained at [`Source`].
///
/// # Errors
/// [`CellError`].
pub fn open(path: &Path, paper: bool) -> Result<(Source, Loaded), CellError> {
    let loaded = cells::open(path, paper)?;
    let source = Source { name: cell_file::shown(path), text: loaded.source.text().to_owned(), paper };
    Ok((source, Loaded(loaded)))
}

/// Compiles a cell.
///
/// # Errors
/// [`CellError::Text`].
pub fn load(Source { name, text, paper }: &Source) -> Result<Loaded, CellError> {
    cells::load(name, text, *paper).map(Loaded)
}

/// Whether some sequence of the program's operations reaches the end of the task.
fn reaches_end(program: &Program) -> bool {
    let handlers = program.handlers.iter().map(|handler| handler.entry);
    let mut next: Vec<u16> = handlers.chain(program.takeover).chain([0]).collect();
    let mut seen = vec![false; program.code.len()];
    while let Some(at) = next.pop() {
        let Some(seen) = seen.get_mut(usize::from(at)).filter(|seen| !**seen) else { continue };
        *seen = true;
        match program.code[usize::from(at)] {
            Op::End => return true,
            Op::Jump(to) => next.push(to),
            Op::Unless(to) | Op::On { to, .. } => next.extend([to, at + 1]),
            Op::Abort(_) | Op::HandlerEnd => {}
            _ => next.push(at + 1),
        }
    }
    false
}

impl Loaded {
    /// The line, from 1, of the statement to which an operation of a task's script belongs.
    pub fn line(&self, task: TaskId, at: u16) -> Option<usize> {
        let script = self.script(task)?;
        Some(self.line_of(*script.spans.get(usize::from(at))?))
    }

    /// The line, from 1, on which the handler begins that contains the statement at `line`; `None` if the statement is
    /// in the task's body.
    pub fn handler(&self, task: TaskId, line: usize) -> Option<usize> {
        let script = self.script(task)?;
        let has_line = |entry: u16| {
            let code = script.program.code.iter().zip(&script.spans).skip(usize::from(entry));
            code.take_while(|(op, _)| **op != Op::HandlerEnd).any(|(_, span)| self.line_of(*span) == line)
        };
        let mut heads = script.program.handlers.iter().zip(&script.handlers);
        heads.find_map(|(handler, head)| has_line(handler.entry).then(|| self.line_of(*head)))
    }

    /// Whether a task can reach the end of its script. A task that serves for ever (`loop` without `exit`) cannot, though it
    /// may abort or lose its lease.
    pub fn can_finish(&self, task: TaskId) -> bool {
        self.program(task).is_none_or(|program| reaches_end(program))
    }

    /// The digest of the scripts of a node; zero if the node has no script.
    pub fn statements(&self, node: NodeId) -> u32 {
        self.statements_of(self.table.tasks_on(node))
    }

    /// The name of an action of a task.
    pub fn action(&self, task: TaskId, action: u16) -> &str {
        self.one_action(task, action).map_or("?", |action| action.name.as_str())
    }

    /// The text of a line; lines count from 1.
    pub fn text_of(&self, line: usize) -> &str {
        self.source.text().lines().nth(line.saturating_sub(1)).unwrap_or_default().trim()
    }

    /// The arguments of an action, as text for people.
    pub fn arguments(&self, task: TaskId, action: u16, values: &[i64]) -> Vec<String> {
        let types = self.one_action(task, action).map_or(&[][..], |action| &action.arguments);
        let of = |(i, &value): (usize, &i64)| shown(types.get(i).copied(), value);
        values.iter().enumerate().map(of).collect()
    }

    /// The result of an action, as text for people; `None` if no statement reads it.
    pub fn result(&self, task: TaskId, action: u16, value: i32) -> Option<String> {
        let of = self.one_action(task, action)?.result?;
        // A `real` is passed as its bits, not as a signed number.
        let bits = i64::from(value.cast_unsigned());
        Some(shown(Some(of), if of == Type::Real { bits } else { i64::from(value) }))
    }

    /// The line, from 1, at which a span begins.
    pub fn line_of(&self, span: Span) -> usize {
        self.source.position(span.start).0
    }

    /// A value that a check reads, as the cell file writes it; `None` for constants and operators.
    pub fn term(&self, term: Term) -> Option<String> {
        let task = |task: TaskId| self.table.cell().tasks.get(task.index()).map(|task| task.name.as_str());
        let port = |port: PortId| self.table.port(port).map(|port| port.decl.name.as_str());
        Some(match term.reads()? {
            Reading::Variable(of, _) => format!("{}.{}", task(of)?, self.variable(term)?.name),
            Reading::Predicate(Predicate::Active(of)) => format!("{}.active", task(of)?),
            Reading::Predicate(Predicate::Asked { task: of, port: at }) => {
                format!("{}.asked({})", task(of)?, port(at)?)
            }
            Reading::Predicate(Predicate::Answered { task: of, port: at }) => {
                format!("{}.answered({})", task(of)?, port(at)?)
            }
            Reading::Predicate(Predicate::Arrived { port: at, task: of }) => {
                format!("{}.arrived({})", port(at)?, task(of)?)
            }
        })
    }

    /// A value of a term, as text for people.
    pub fn shown(&self, term: Term, value: i64) -> String {
        let is_truth = matches!(term, Term::Is(_));
        shown(self.variable(term).map(|variable| variable.of).or(is_truth.then_some(Type::Bool)), value)
    }

    fn variable(&self, term: Term) -> Option<&Variable> {
        let Term::Of { task, variable } = term else { return None };
        self.program(task)?.variables.get(usize::from(variable))
    }

    /// The time limit of the check of this name; `None` if the check is no `leads`.
    pub fn within(&self, check: &str) -> Option<u64> {
        let check = self.checks.iter().find(|one| one.name == check)?;
        match &check.kind {
            CheckKind::Leads { within, .. } => Some(within.0),
            CheckKind::Always(_) => None,
        }
    }

    fn one_action(&self, task: TaskId, action: u16) -> Option<&Action> {
        self.script(task)?.actions.get(usize::from(action))
    }
}

fn shown(of: Option<Type>, value: i64) -> String {
    match of {
        Some(Type::Real) => u32::try_from(value).map_or(0.0, f32::from_bits).to_string(),
        Some(Type::Bool) => (value != 0).to_string(),
        Some(Type::Int8 | Type::Int16 | Type::Int32 | Type::Word) | None => value.to_string(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The compiled cell of the beam lift.
    pub fn beam_lift() -> Loaded {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/beam_lift.cell");
        open(Path::new(path), false).expect("a sound cell").1
    }
}
