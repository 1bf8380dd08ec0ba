//! Looks for the script steps of a run in the state space of [`check_cell`](crate::cell::check_cell): without faults at the times
//! of [`Times::Between`], and with the declared faults at the plan's times.

use super::run::{Happened, Run, Turn};
use crate::cell::outside::with_programs;
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::run_state::{CellMove, RunState};
use imrs_protocol::script::{Address, End, ScriptInput};
use imrs_protocol::{Call, Outcome, PortId, Signal, TaskId};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

/// The number of moves of one random walk through the model.
const LENGTH: usize = 6_000;

/// A kind of script step, without contents: where the script waited, which input it got, which statements it began.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    task: usize,
    at: Address,
    came: (u8, Option<PortId>),
    passed: Vec<Address>,
    ended: bool,
}

impl Kind {
    fn of(task: usize, turn: &Turn) -> Self {
        let ended = turn.end.is_some_and(|end| end != End::Finished);
        Self { task, at: turn.at, came: came(&turn.input), passed: turn.passed.clone(), ended }
    }
}

/// The result of comparing the script steps of a run with those that random walks through the model take.
#[derive(Clone, Debug, Default)]
pub struct Steps {
    /// The number of different kinds of script steps in the run.
    pub kinds: usize,
    /// Kinds of steps that no random walk took: the task, and the operation in which its script waited.
    pub missing: Vec<(TaskId, Address)>,
    /// The number of random walks through the model.
    pub walks: u64,
}

/// Makes random walks through the model within the plan's faults, until they have met every kind of script step of the run,
/// or the plan's time is used up. The walks are the same in every call. A kind that no walk met may still be possible.
#[must_use]
pub fn steps_in_model(plan: &Arc<CellPlan>, run: &Run) -> Steps {
    let (start, plan) = (Instant::now(), with_programs(plan));
    let mut missing = BTreeSet::new();
    for happening in run.tasks.iter().flatten() {
        if let Happened::Turn(turn) = &happening.what {
            missing.insert(Kind::of(happening.task.index(), turn));
        }
    }
    let mut steps = Steps { kinds: missing.len(), ..Steps::default() };
    let mut draw = Draw(1);
    let between = plan.timed(Times::Between);
    while !missing.is_empty() && start.elapsed().as_secs_f64() < plan.budget.seconds {
        steps.walks += 1;
        // Half of the random walks have no faults, because a walk with faults seldom reaches steps that need a long time
        // without a fault.
        match draw.below(2) {
            0 => walk(&between, &CellFaults::default(), &mut draw, &mut missing),
            _ => {
                let hypothesis = plan.faults.get(draw.below(plan.faults.len()));
                walk(&plan, &hypothesis.cloned().unwrap_or_default(), &mut draw, &mut missing);
            }
        }
    }
    steps.missing = missing.iter().map(|kind| (TaskId::from_index(kind.task), kind.at)).collect();
    steps.missing.dedup();
    steps
}

fn walk(plan: &Arc<CellPlan>, faults: &CellFaults, draw: &mut Draw, missing: &mut BTreeSet<Kind>) {
    let mut run_state = RunState::new(plan, faults);
    let mut moves = Vec::new();
    for _ in 0..LENGTH {
        for turn in run_state.cell.turns.as_mut().map(std::mem::take).unwrap_or_default() {
            let (at, input, passed, end) = (turn.at, turn.input, turn.passed, turn.end);
            missing.remove(&Kind::of(turn.task, &Turn { at, input, passed, end }));
        }
        moves.clear();
        run_state.moves(&mut moves);
        // Losing one more packet of a link whose cut has begun is no new fault.
        let is_fault = |step: &CellMove| step.is_fault() && !matches!(step, CellMove::Vanish(_));
        // Faults are drawn rarely, or they would all happen at the beginning of a walk.
        if draw.below(64) > 0 && moves.iter().any(|step| !is_fault(step)) {
            moves.retain(|step| !is_fault(step));
        }
        let Some(&step) = moves.get(draw.below(moves.len())) else { return };
        if !run_state.survives(step) || run_state.cell.violation.is_some() || missing.is_empty() {
            return;
        }
    }
}

/// The kind of a script's input, without numbers and contents.
fn came(input: &ScriptInput) -> (u8, Option<PortId>) {
    let signal = match input {
        ScriptInput::Begin => return (0, None),
        ScriptInput::Acted { ok, .. } => return (1 + u8::from(*ok), None),
        ScriptInput::Chosen(_) => return (3, None),
        ScriptInput::Signal(signal) => signal,
    };
    match signal {
        Signal::Accepted(_) => (4, None),
        Signal::Fault(_) => (5, None),
        Signal::Outcome(outcome) => {
            let way = match outcome {
                Outcome::Reply(_) => 6,
                Outcome::Refused => 7,
                Outcome::TimedOutUnsent => 8,
                Outcome::TimedOutUnknown => 9,
                Outcome::PeerRestarted => 10,
            };
            (way, None)
        }
        Signal::Answers { port, .. } => (11, Some(*port)),
        Signal::Interrupt(Call::Message(delivery)) => (12, Some(delivery.from.port)),
        Signal::Interrupt(Call::Timer(id)) => (13, Some(PortId(u16::from(id.0)))),
        Signal::Interrupt(Call::Fenced) => (14, None),
        Signal::Interrupt(Call::TakeOver(_)) => (15, None),
        Signal::Granted(_) => (16, None),
        Signal::Message(delivery) => (17, Some(delivery.from.port)),
        Signal::Nothing => (18, None),
        Signal::Released { port, .. } => (19, Some(*port)),
        Signal::GaveUp { port, .. } => (20, Some(*port)),
        Signal::TimeOut(id) => (21, Some(PortId(u16::from(id.0)))),
        Signal::Cancelled => (22, None),
    }
}

/// Pseudo-random numbers (xorshift).
struct Draw(u64);

impl Draw {
    fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from(self.0 % limit.max(1) as u64).unwrap_or(0)
    }
}
