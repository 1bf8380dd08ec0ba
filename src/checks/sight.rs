//! What checks ask of the tasks of a node, seen after every step.

use super::{Ask, asks};
use crate::cells::Loaded;
use imrs_protocol::script::Activity;
use imrs_protocol::{CommTask, Outcome, PortId, Request, Signal, TaskId};
use imrs_runtime::script::{Note, Stands, Watch};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Sees what checks ask of the tasks of a node.
pub struct Sight {
    /// By task.
    asks: Vec<Vec<Ask>>,
    known: Vec<Known>,
}

/// What is known of a task.
#[derive(Clone, Debug, Default)]
struct Known {
    /// As they were last seen.
    values: Vec<i64>,
    /// When its lease ends, in microseconds of the node's clock, unless it is renewed.
    leased_until: Option<u64>,
    /// The ports of its requests whose ends are still to come, the last one last: a handler asks while its task waits.
    open: Vec<PortId>,
    /// It has just asked to send: what is accepted at once has no other end.
    sends: bool,
    /// By port, whether the last request there was answered.
    answered: BTreeMap<PortId, bool>,
    /// The waitfors that it reached.
    reached: Vec<PortId>,
}

impl Sight {
    /// Nothing yet.
    pub fn new(loaded: &Loaded) -> Self {
        let asks = asks(loaded);
        Self { known: vec![Known::default(); asks.len()], asks }
    }

    /// Whether no check asks anything.
    pub fn is_blind(&self) -> bool {
        self.asks.iter().all(Vec::is_empty)
    }

    /// The script of a task did something.
    pub fn note(&mut self, task: TaskId, note: &Note) {
        let Some(known) = self.known.get_mut(task.index()) else { return };
        match note {
            Note::Asked(request) => known.asked(request),
            Note::Answered(signal) => known.ended(signal),
            Note::Statement(_)
            | Note::Acts { .. }
            | Note::Acted { .. }
            | Note::CutShort(_)
            | Note::Unanswered(_)
            | Note::Ended(_) => {}
        }
    }

    /// How a task stands at `at`: its values, in the order of what is asked, where one has changed.
    ///
    /// A task is active no longer than its lease lasts, though a node that stood still notices the end late: that comes as a
    /// change of its own, from when the lease ended (D153).
    pub fn look(&mut self, task: TaskId, at: u64, stands: &Stands<'_>) -> impl Iterator<Item = Change> {
        let seen = self.asks.get(task.index()).zip(self.known.get_mut(task.index()));
        let changes = seen.map(|(asks, known)| {
            let ended = known.lease_ends(asks, at, stands);
            let values: Vec<i64> = asks.iter().map(|&ask| known.value(ask, stands)).collect();
            let changed = values != known.values;
            known.values.clone_from(&values);
            [ended, changed.then_some((at, values))]
        });
        changes.into_iter().flatten().flatten().map(move |(at, values)| Change { at, task, values })
    }
}

impl Known {
    /// The lease of a task that was active ended before `at`, when that was noticed: since when, and what it stands at since.
    fn lease_ends(&mut self, asks: &[Ask], at: u64, stands: &Stands<'_>) -> Option<(u64, Vec<i64>)> {
        let now = stands.machine.lease_left().map(|left| at.saturating_add(left.0));
        let before = std::mem::replace(&mut self.leased_until, now).filter(|&until| until < at);
        let since = before.filter(|_| !stands.machine.is_active())?;
        let was_active =
            |(ask, value): (&Ask, &mut i64)| *ask == Ask::Active && std::mem::replace(value, 0) != 0;
        let ended = asks.iter().zip(&mut self.values).map(was_active).fold(false, |any, one| any | one);
        ended.then(|| (since, self.values.clone()))
    }

    fn asked(&mut self, request: &Request) {
        self.sends = false;
        match *request {
            Request::Arrive { port, .. } if !self.reached.contains(&port) => self.reached.push(port),
            Request::Send { port, .. } => {
                self.sends = true;
                self.open.push(port);
                self.answered.insert(port, false);
            }
            _ => {}
        }
    }

    fn ended(&mut self, signal: &Signal) {
        let sends = std::mem::replace(&mut self.sends, false);
        let end = match signal {
            Signal::Outcome(outcome) => Some((self.open.pop(), matches!(outcome, Outcome::Reply(_)))),
            Signal::Answers { port, answers } => {
                self.open.pop();
                Some((Some(*port), answers.asked == answers.answered))
            }
            Signal::Accepted(_) | Signal::Fault(_) if sends => {
                self.open.pop();
                None
            }
            _ => None,
        };
        if let Some((Some(port), answered)) = end {
            self.answered.insert(port, answered);
        }
    }

    /// As the model has it.
    fn value(&self, ask: Ask, stands: &Stands<'_>) -> i64 {
        let Stands { script, machine } = *stands;
        match ask {
            Ask::Variable(at) => script.var(at).unwrap_or(0),
            Ask::Active => i64::from(acts(script.activity()) && machine.is_active()),
            Ask::Asked(port) => i64::from(machine.outstanding().any(|(at, ..)| at == port)),
            Ask::Answered(port) => i64::from(self.answered.get(&port).is_some_and(|answered| *answered)),
            Ask::Arrived(port) if self.reached.contains(&port) => round(machine, port),
            Ask::Arrived(_) => -1,
        }
    }
}

const fn acts(activity: Activity) -> bool {
    !matches!(activity, Activity::NotBegun | Activity::Passive | Activity::Ended(_))
}

fn round(machine: &CommTask, port: PortId) -> i64 {
    machine.announced(port).map_or(0, |round| i64::from(round.0) + 1)
}

/// A task stands otherwise.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// Since when, on the boot-time clock that all processes of one machine share, in microseconds.
    pub at: u64,
    /// The task.
    pub task: TaskId,
    /// What checks ask of it, in the order of [`asks`].
    pub values: Vec<i64>,
}

/// Looks at a recording that is run again.
pub struct Looker(Mutex<(Sight, Vec<Change>)>);

impl Looker {
    /// Nothing yet.
    pub fn new(loaded: &Loaded) -> Self {
        Self(Mutex::new((Sight::new(loaded), Vec::new())))
    }

    /// What changed since this was last asked, in the times of the replay.
    pub fn changes(&self) -> Vec<Change> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner).1)
    }
}

impl Watch for Looker {
    fn note(&self, task: TaskId, _at: u64, note: &Note) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0.note(task, note);
    }

    fn stands(&self, task: TaskId, at: u64, stands: &Stands<'_>) {
        let (sight, changes) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        changes.extend(sight.look(task, at, stands));
    }
}
