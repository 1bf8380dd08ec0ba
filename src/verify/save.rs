//! Saves the counterexample of a finding as a recording. It holds the frames that monitors of all nodes would have seen,
//! with a text for each step.

use super::subject::Subject;
use crate::failure::Failure;
use crate::kept;
use imrs_model::cell::{CellPlan, Finding, Scene, Shows, scenes};
use imrs_protocol::NodeId;
use imrs_wire::obs::{
    Events, Hello, NodeIdentity, Role, SCHEMA, ServerFrame, Snapshot, Table, TimedEvent, VERSION,
};
use imrs_wire::recording::{Doing, Header, Place, Record, RecordingWriter, Shown, Step, Story, WriteError};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

const BUILD: &str = concat!("imrs ", env!("CARGO_PKG_VERSION"));

/// Saves the counterexample of a finding. Returns false if the finding has no counterexample: for example, no path
/// leads to an unreachable statement.
///
/// # Errors
/// An error if the file cannot be written.
pub(super) fn save(
    path: &Path,
    subject: &Subject,
    plan: &Arc<CellPlan>,
    finding: &Finding,
    bounds: String,
    force: bool,
) -> Result<bool, Failure> {
    let scenes = scenes(plan, finding);
    if scenes.is_empty() {
        return Ok(false);
    }
    kept::keep(path, force, |file| {
        let written = Film::begin(BufWriter::new(file), subject)
            .and_then(|film| film.write(&scenes, subject.story(finding, bounds, scenes.len())));
        written.map_err(|error| match error {
            WriteError::Io(error) => error,
            other @ (WriteError::Encode(_) | WriteError::TooLong(_)) => io::Error::other(other.to_string()),
        })
    })?;
    Ok(true)
}

impl Subject {
    fn story(&self, finding: &Finding, bounds: String, scenes: usize) -> Story {
        let (line, column, text) = self.place_of(finding);
        let place = Some(Place { line: small(line), column: small(column), text: text.into() });
        Story {
            file: self.file.clone(),
            kind: finding.kind.name().into(),
            cause: finding.cause.clone(),
            place,
            bounds,
            tick_us: self.tick_us,
            steps: small(scenes.saturating_sub(1)),
        }
    }

    /// A step as text.
    fn step(&self, number: usize, scene: &Scene) -> Step {
        let words = |happening: &Shows| match happening {
            Shows::Said(words) => Some(words.clone()),
            // An extern task has no statement that could be shown.
            Shows::Began(task, at) => {
                let (line, _, text) = self.place(*task, *at)?;
                let name = self.task(*task);
                // If a task only answers, the text of its statement is the task's name.
                Some(if text == name {
                    format!("{name} begins (line {line})")
                } else {
                    format!("{name} begins line {line}: {text}")
                })
            }
        };
        let happened = scene.happened.iter().filter_map(words).collect();
        let doing = |(i, view): (usize, &imrs_model::cell::TaskView)| {
            let task = imrs_protocol::TaskId::from_index(i);
            Doing {
                task,
                text: view.does.clone(),
                line: self.place(task, view.at).map(|(line, ..)| small(line)),
            }
        };
        let tasks = scene.tasks.iter().enumerate().map(doing).collect();
        Step { number: small(number), tick: scene.tick, odd: scene.odd, happened, tasks }
    }
}

/// Writes the recording of a counterexample.
struct Film<'a, W> {
    writer: RecordingWriter<W>,
    subject: &'a Subject,
    /// For each node, the incarnation whose frames the recording shows at present.
    attached: Vec<Option<imrs_protocol::Incarnation>>,
    at: u64,
}

impl<'a, W: Write> Film<'a, W> {
    fn begin(sink: W, subject: &'a Subject) -> Result<Self, WriteError> {
        let cell = subject.table.cell();
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let header = Header {
            cell: cell.name.clone(),
            digest: subject.table.digest(),
            build: BUILD.into(),
            began: u64::try_from(since.as_micros()).unwrap_or(0),
            ..Header::default()
        };
        let writer = RecordingWriter::new(sink, &header)?;
        Ok(Self { writer, subject, attached: vec![None; cell.nodes.len()], at: 0 })
    }

    fn write(mut self, scenes: &[Scene], story: Story) -> Result<(), WriteError> {
        self.frame(0, &Shown::Story(story))?;
        for (number, scene) in scenes.iter().enumerate() {
            self.at = scene.tick.saturating_mul(self.subject.tick_us);
            self.frame(0, &Shown::Step(self.subject.step(number, scene)))?;
            for node in 0..scene.nodes.len() {
                self.node(node, scene)?;
            }
        }
        self.writer.finish()?.flush()?;
        Ok(())
    }

    fn node(&mut self, node: usize, scene: &Scene) -> Result<(), WriteError> {
        let frame = &scene.nodes[node];
        if self.attached[node]
            .is_some_and(|incarnation| frame.snapshot.is_none() || incarnation != frame.incarnation)
        {
            self.attached[node] = None;
            self.frame(node, &Shown::Lost { why: "it crashed".into() })?;
        }
        let Some(snapshot) = &frame.snapshot else { return Ok(()) };
        if self.attached[node].is_none() {
            self.attached[node] = Some(frame.incarnation);
            self.introduce(node, frame.incarnation)?;
        }
        let mono_us = self.at;
        if !frame.observed.is_empty() {
            let event = |&(task, what)| TimedEvent { mono_us, task, what };
            let events = frame.observed.iter().map(event).collect();
            self.frame(node, &Shown::Said(ServerFrame::Events(Events { lost: 0, events })))?;
        }
        let snapshot = Snapshot { mono_us, uptime_us: mono_us, ..snapshot.clone() };
        self.frame(node, &Shown::Said(ServerFrame::Snapshot(snapshot)))
    }

    fn introduce(&mut self, node: usize, incarnation: imrs_protocol::Incarnation) -> Result<(), WriteError> {
        let cell = self.subject.table.cell();
        let identity = NodeIdentity {
            cell: cell.name.clone(),
            digest: self.subject.table.digest(),
            node: cell.nodes[node].name.clone(),
            id: NodeId::from_index(node).0,
            incarnation,
            tick_us: self.subject.tick_us,
        };
        let role = Role::Node(identity);
        let hello = Hello { schema: SCHEMA, pid: 0, build: BUILD.into(), mono_us: self.at, role };
        self.frame(node, &Shown::Attached { version: VERSION, hello })?;
        self.frame(node, &Shown::Said(ServerFrame::Table(Table::of(&self.subject.table))))
    }

    fn frame(&mut self, node: usize, shown: &Shown) -> Result<(), WriteError> {
        let source = NodeId::from_index(node).0;
        self.writer.append(&Record::Frame { source, at: self.at, bytes: shown.encode() })
    }
}

fn small(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
