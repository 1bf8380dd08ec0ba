//! Samples, after every step, the values of a node's tasks that checks read.

use super::{Ask, asks};
use crate::cells::Loaded;
use imrs_protocol::script::Activity;
use imrs_protocol::{CommTask, Outcome, PortId, Request, Signal, TaskId};
use imrs_runtime::script::{Note, Stands, Watch};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Samples the values of tasks that checks read, and reports changes.
pub struct ValueSampler {
    /// For each task, which of its values the checks read.
    asks: Vec<Vec<Ask>>,
    known: Vec<Known>,
}

/// The last sample of a task, with the facts that the next samples need.
#[derive(Clone, Debug, Default)]
struct Known {
    /// The values of the last sample.
    values: Vec<i64>,
    /// When the task's lease ends unless it is renewed, in microseconds of the node's clock.
    leased_until: Option<u64>,
    /// The ports of the task's outstanding requests, the newest last. There may be several, because a handler may send
    /// while its task waits.
    open: Vec<PortId>,
    /// Whether the task's last request was a send. After a send of class 1 no outcome follows.
    sends: bool,
    /// For each port, whether the task's last request on that port was answered.
    answered: BTreeMap<PortId, bool>,
    /// The waitfors that the task has reached in this incarnation.
    reached: Vec<PortId>,
}

impl ValueSampler {
    /// A sampler without samples yet.
    pub fn new(loaded: &Loaded) -> Self {
        let asks = asks(loaded);
        Self { known: vec![Known::default(); asks.len()], asks }
    }

    /// Whether no check reads any value.
    pub fn is_blind(&self) -> bool {
        self.asks.iter().all(Vec::is_empty)
    }

    /// Takes an event of a task's script.
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

    /// Samples a task at `at`. Returns the task's values if any of them has changed.
    ///
    /// A lease ends the activity of its task on time, even if the node was suspended and notices the end late. So an
    /// end that is noticed late is a change of its own, with the time at which the lease ended (D153).
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
    /// The node noticed at `at` that the lease of an active task has ended. Returns the time of that end, and the
    /// values since then; `None` if there was no such end.
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

    /// The value of `ask` for a task, by the definition that the checker uses.
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

/// A change of the values of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// The instant since which the values hold, in microseconds of the boot-time clock that all processes of one machine
    /// share.
    pub at: u64,
    /// The task whose values changed.
    pub task: TaskId,
    /// All values of the task that checks read, in the order in which [`asks`] lists them.
    pub values: Vec<i64>,
}

/// Samples the tasks of a recording while it is replayed.
pub struct ReplaySampler(Mutex<(ValueSampler, Vec<Change>)>);

impl ReplaySampler {
    /// A sampler without samples yet.
    pub fn new(loaded: &Loaded) -> Self {
        Self(Mutex::new((ValueSampler::new(loaded), Vec::new())))
    }

    /// Takes the changes since the last call, in the times of the replay.
    pub fn changes(&self) -> Vec<Change> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner).1)
    }
}

impl Watch for ReplaySampler {
    fn note(&self, task: TaskId, _at: u64, note: &Note) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0.note(task, note);
    }

    fn stands(&self, task: TaskId, at: u64, stands: &Stands<'_>) {
        let (sampler, changes) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        changes.extend(sampler.look(task, at, stands));
    }
}
