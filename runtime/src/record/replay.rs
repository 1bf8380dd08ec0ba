//! Runs a state machine again on recorded inputs, and compares all its outputs.
//!
//! Lost records cannot be judged: the replay goes on from the next keyframe, and its verdict is [`Verdict::Unknown`], never
//! [`Verdict::Same`].

use super::script::{Again, Watched};
use super::verdict::{Divergence, InvariantBroken, Miscount, ScriptDivergence, Verdict};
use super::{Digesting, OutputDigest, Step, run_checked};
use crate::script::Watch;
use imrs_protocol::script::Program;
use imrs_protocol::{
    CommTask, Incarnation, Input, NodeTable, Outbox, Packet, Request, Signal, TaskId, TaskState, Ticks,
    TimeId, invariants,
};
use imrs_wire::recording::{Happened, Happening, ScriptStep};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// A recorded step, and the recorded digest after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// The recorded step.
    pub step: Step,
    /// The digest of all outputs up to this step.
    pub digest: OutputDigest,
}

/// Why a replay cannot go on from a keyframe.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyframeError {
    /// This build cannot read the state.
    #[error("the state of {0} cannot be read: {1}")]
    Malformed(TaskId, postcard::Error),
    /// The keyframe has more bytes than the state of a state machine needs.
    #[error("the state of {0} has {1} bytes too many")]
    Trailing(TaskId, usize),
    /// The state belongs to another task, or to another incarnation of the node.
    #[error("the state given for {0} is that of {1} in incarnation {incarnation}", incarnation = .2.0)]
    Foreign(TaskId, TaskId, Incarnation),
    /// The state does not belong to a state machine with the ports of this task: parts are missing, too many or out
    /// of bounds.
    #[error("the state of {0} is not one of its machine")]
    OutOfBounds(TaskId),
    /// The state machine never reaches this state.
    #[error("the state of {0} breaks an invariant of its machine: {1}")]
    Unsound(TaskId, invariants::Violation),
    /// No step is missing before the keyframe, but its state or its outputs differ from those of the replay.
    #[error("the keyframe of {0} contradicts the steps before it")]
    Contradicts(TaskId),
}

/// A communication task that is replayed, step by step.
#[derive(Clone, Debug)]
pub struct Replay<'t> {
    table: &'t NodeTable,
    task: TaskId,
    incarnation: Incarnation,
    /// The replayed state machine; `None` while its state is not known.
    machine: Option<CommTask>,
    digest: OutputDigest,
    judged: usize,
    unjudged: usize,
    lost: u64,
    divergence: Option<Divergence>,
    broken: Option<InvariantBroken>,
    miscount: Option<Miscount>,
    closed: bool,
    /// The replayed script; `None` if the task has no script to replay, or the script's state is not known.
    script: Option<Again>,
    script_divergence: Option<ScriptDivergence>,
    /// The time since the first step, in microseconds.
    passed: u64,
    /// The node's clock at the first step.
    base: Option<u64>,
    /// The events of the replay, each with its time in microseconds since the first step; `None` if events are not kept.
    happened: Option<Vec<(u64, Happened)>>,
}

impl<'t> Replay<'t> {
    /// The replay of `task`, whose state machine begins at the start of this incarnation of its node.
    #[must_use]
    pub fn new(table: &'t NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        Self {
            table,
            task,
            incarnation,
            machine: Some(CommTask::new(table, task, incarnation, restarted)),
            digest: OutputDigest::START,
            judged: 0,
            unjudged: 0,
            lost: 0,
            divergence: None,
            broken: None,
            miscount: None,
            closed: false,
            script: None,
            script_divergence: None,
            passed: 0,
            base: None,
            happened: None,
        }
    }

    /// Makes the replay run the task's script, too.
    #[must_use]
    pub fn with_script(self, program: &Arc<Program>) -> Self {
        Self { script: Some(Again::new(program)), ..self }
    }

    /// Calls `watch` with the script's requests, their answers and its task's state. Times count from [`base`](Self::base).
    #[must_use]
    pub fn watched(mut self, watch: &Arc<dyn Watch>) -> Self {
        let watched = Watched { task: self.task, watch: Arc::clone(watch) };
        if let Some(script) = &mut self.script {
            script.watched = Some(watched);
        }
        self
    }

    /// The time of the first step, in microseconds of the node's clock (`CLOCK_BOOTTIME`); `None` if no script has begun.
    #[must_use]
    pub const fn base(&self) -> Option<u64> {
        self.base
    }

    /// Makes the replay keep everything that happens, for [`happened`](Self::happened).
    #[must_use]
    pub fn keeping(self) -> Self {
        Self { happened: Some(Vec::new()), ..self }
    }

    /// Runs the next step. After a gap, or after a step whose outputs differ, only counts steps until the next
    /// keyframe.
    pub fn step(&mut self, entry: Recorded) {
        if self.closed {
            // A step after the end of the task is only counted, and reported as one step too many.
            self.unjudged += 1;
            self.close(self.found() - 1, self.digest);
            return;
        }
        if self.machine.is_none() {
            self.unjudged += 1;
            return;
        }
        self.passed = self.passed.saturating_add(entry.step.elapsed.0);
        if self.script.as_mut().is_some_and(|script| !script.expects(&entry.step.input)) {
            self.lose_script();
        }
        // The script stopped now, with its last request, and not at the earlier time that `Stopped` has.
        if let Input::Request(Request::Cancel) = entry.step.input
            && let Some((at, Happened::Stopped)) =
                self.happened.as_mut().and_then(|happened| happened.last_mut())
        {
            *at = self.passed;
        }
        let Some(machine) = &mut self.machine else { return };
        let mut heard =
            Heard { at: self.passed, happened: self.happened.as_mut(), script: self.script.as_mut() };
        match entry.step.input {
            Input::Packet(packet) => heard.note(Happened::Came(packet)),
            Input::PeerRestarted(node) => heard.note(Happened::PeerRestarted(node)),
            Input::PeerStopped(node) => heard.note(match machine.view(self.table, 0).state {
                TaskState::AwaitingReply { .. } => Happened::PeerStopped(node),
                _ => Happened::Time,
            }),
            Input::Unsent(id) => heard.note(Happened::Unsent(id)),
            Input::Time | Input::TimeOut { .. } => heard.note(Happened::Time),
            Input::Request(_) => {}
        }
        let mut out = Digesting { digest: Some(&mut self.digest), out: &mut heard };
        let run = || run_checked((machine, self.table), entry.step, &mut out);
        // A recording may contain anything: if the state machine panics on an input, the recording is wrong.
        let ran = catch_unwind(AssertUnwindSafe(run)).ok();
        let (sound, went_wrong) = (ran.unwrap_or(Ok(())), ran.is_none());
        if let Err(violation) = sound {
            let index = self.judged + self.unjudged;
            self.broken.get_or_insert(InvariantBroken { task: self.task, index, violation });
        }
        if self.digest == entry.digest && !went_wrong {
            self.judged += 1;
            self.let_script_go_on();
            return;
        }
        let (recorded, replayed) = (entry.digest, self.digest);
        let index = self.judged + self.unjudged;
        let divergence = Divergence { task: self.task, index, step: entry.step, recorded, replayed };
        self.divergence.get_or_insert(divergence);
        self.unjudged += 1;
        (self.machine, self.script) = (None, None);
    }

    /// Gives the script a step that its communication task did not cause, such as the end of an action.
    pub fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        if let ScriptStep::Begin { at } = step {
            self.base.get_or_insert(at.saturating_sub(self.passed));
        }
        let (Some(script), Some(_)) = (&mut self.script, &self.machine) else { return };
        let Some(what) = script.take(step, done) else { return self.lose_script() };
        if let Some(happened) = &mut self.happened {
            happened.push((self.passed, what));
        }
        self.let_script_go_on();
    }

    fn lose_script(&mut self) {
        let index = self.judged + self.unjudged;
        self.script_divergence.get_or_insert(ScriptDivergence { task: self.task, index });
        self.script = None;
    }

    fn let_script_go_on(&mut self) {
        let (Some(script), Some(machine)) = (&mut self.script, &self.machine) else { return };
        script.go_on(self.passed, (machine, self.table), self.happened.as_mut());
        script.show(self.passed, machine);
    }

    /// The kept events, in order. `None` if the time of the first step is not known, or if records are missing.
    #[must_use]
    pub fn happened(self) -> Option<Vec<Happening>> {
        let (task, base) = (self.task, self.base?);
        let all = self.happened.filter(|_| self.script.is_some())?;
        let started = std::iter::once((0, Happened::Started));
        Some(
            started
                .chain(all)
                .map(|(at, what)| Happening { at: base.saturating_add(at), task, what })
                .collect(),
        )
    }

    /// Notes that records are missing here.
    pub fn gap(&mut self, lost: u64) {
        self.lost = self.lost.saturating_add(lost);
        (self.machine, self.script) = (None, None);
    }

    /// Notes that the node stopped. Its task took `inputs` inputs since the node's start; `outputs` digests all its outputs.
    pub fn close(&mut self, inputs: u64, outputs: OutputDigest) {
        self.closed = true;
        let found = self.found();
        // The records that were lost need not all be inputs.
        let counts = found <= inputs && inputs <= found.saturating_add(self.lost);
        if !counts || (self.machine.is_some() && outputs != self.digest) {
            let (task, said, said_outputs, outputs) = (self.task, inputs, outputs, self.digest);
            self.miscount.get_or_insert(Miscount { task, said, found, said_outputs, outputs });
        }
    }

    fn found(&self) -> u64 {
        (self.judged + self.unjudged) as u64
    }

    /// Continues the replay from a recorded state.
    ///
    /// # Errors
    /// [`KeyframeError`]. The replay's state has not changed then.
    pub fn keyframe(&mut self, state: &[u8], digest: OutputDigest) -> Result<(), KeyframeError> {
        let (machine, rest) = postcard::take_from_bytes::<CommTask>(state)
            .map_err(|error| KeyframeError::Malformed(self.task, error))?;
        if !rest.is_empty() {
            return Err(KeyframeError::Trailing(self.task, rest.len()));
        }
        let (task, incarnation) = (machine.task(), machine.incarnation());
        if (task, incarnation) != (self.task, self.incarnation) {
            return Err(KeyframeError::Foreign(self.task, task, incarnation));
        }
        if !machine.is_whole(self.table) {
            return Err(KeyframeError::OutOfBounds(task));
        }
        invariants::check(&machine, self.table).map_err(|found| KeyframeError::Unsound(task, found))?;
        if let Some(known) = &self.machine {
            let same = postcard::to_allocvec(known).is_ok_and(|known| known == state);
            if digest != self.digest || !same {
                return Err(KeyframeError::Contradicts(self.task));
            }
        }
        (self.machine, self.digest) = (Some(machine), digest);
        Ok(())
    }

    /// Whether the cell has all tasks and ports of an input. A running node drops other packets earlier.
    pub(super) fn knows(&self, input: &Input) -> bool {
        match input {
            Input::Packet(packet) => {
                let ends = [packet.source, packet.destination];
                self.table.port(packet.port).is_some()
                    && ends.into_iter().all(|task| self.table.location(task).is_some())
            }
            Input::PeerRestarted(node) | Input::PeerStopped(node) => {
                node.index() < self.table.cell.cell().nodes.len()
            }
            Input::Time | Input::Request(_) | Input::TimeOut { .. } | Input::Unsent(_) => true,
        }
    }

    /// The time from the task's first step to its last step so far, in microseconds.
    pub(super) const fn passed(&self) -> u64 {
        self.passed
    }

    /// The replayed task.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.task
    }

    /// How many replayed steps gave the recorded outputs.
    #[must_use]
    pub const fn judged(&self) -> usize {
        self.judged
    }

    /// How many recorded steps could not be judged: the state before them is not known, or an earlier step differed.
    #[must_use]
    pub const fn unjudged(&self) -> usize {
        self.unjudged
    }

    /// How many records are missing so far.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// The verdict on the steps that were replayed so far. Once a step differs from the recording, the verdict stays.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        if let Some(broken) = self.broken {
            return Verdict::Breaks(broken);
        }
        if let Some(divergence) = self.script_divergence {
            return Verdict::ScriptDiffers(divergence);
        }
        match (self.divergence, self.miscount) {
            (Some(divergence), _) => Verdict::Differs(divergence),
            (None, Some(miscount)) => Verdict::Miscounts(miscount),
            (None, None) if self.lost > 0 || self.unjudged > 0 || self.machine.is_none() => Verdict::Unknown,
            (None, None) => Verdict::Same,
        }
    }
}

/// Runs the state machine of `task` through its recorded inputs, from the start of this incarnation of its node, and
/// compares all its outputs. Returns how many steps ran.
///
/// # Errors
/// The first step whose outputs differ.
pub fn replay(
    table: &NodeTable,
    task: TaskId,
    incarnation: Incarnation,
    restarted: bool,
    recorded: impl IntoIterator<Item = Recorded>,
) -> Result<usize, Divergence> {
    let mut replay = Replay::new(table, task, incarnation, restarted);
    for entry in recorded {
        replay.step(entry);
        if let Some(divergence) = replay.divergence {
            return Err(divergence);
        }
    }
    Ok(replay.judged)
}

/// The outbox of a step in the replay.
struct Heard<'a> {
    at: u64,
    happened: Option<&'a mut Vec<(u64, Happened)>>,
    script: Option<&'a mut Again>,
}

impl Heard<'_> {
    fn note(&mut self, what: Happened) {
        if let Some(happened) = &mut self.happened {
            happened.push((self.at, what));
        }
    }
}

impl Outbox for Heard<'_> {
    fn transmit(&mut self, packet: Packet) {
        self.note(Happened::Sent(packet));
    }

    fn signal(&mut self, signal: Signal) {
        if let Some(script) = &mut self.script {
            script.said(signal);
        }
    }

    fn arm(&mut self, _id: TimeId, _turn: u8, _length: Ticks) {}
    fn disarm(&mut self, _id: TimeId) {}
}
