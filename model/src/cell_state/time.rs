//! Time in a cell state: ticks that nodes notice, leave out, count twice or notice later; crashes and restarts.

use super::body::{Body, Does};
use super::plan::Errand;
use super::{CellState, Move};
use crate::state::Violation;
use imrs_protocol::{CommTask, Node, NodeInput, Pass, PortId, Round, Seq24, TaskId, Ticks, Walk};

/// How a node counts a tick: two bits of the code of [`Move::Tick`].
const LEFT_OUT: u16 = 1;
const TWICE: u16 = 2;
const LATER: u16 = 3;

impl CellState {
    /// Lists all ways in which a tick can pass within the fault budgets.
    pub(super) fn ticks(&self, moves: &mut Vec<Move>) {
        let mut codes = vec![(0_u16, self.faults.drift, self.faults.late)];
        for (i, node_state) in self.nodes.iter().enumerate() {
            let place = 2 * i;
            let more: Vec<_> = codes
                .iter()
                .filter(|_| node_state.up)
                .flat_map(|&(code, drift, late)| {
                    let odd = |what: u16| code | (what << place);
                    let drifts = (drift > 0).then(|| [LEFT_OUT, TWICE].map(|w| (odd(w), drift - 1, late)));
                    let later = (late > 0 && node_state.owed == 0).then(|| (odd(LATER), drift, late - 1));
                    drifts.into_iter().flatten().chain(later)
                })
                .collect();
            codes.extend(more);
        }
        moves.extend(codes.into_iter().map(|(code, ..)| Move::Tick(code)));
    }

    pub(super) fn tick(&mut self, code: u16) -> Result<(), Violation> {
        let alone = self.plan.jumps && code == 0 && self.faults.drift == 0 && self.faults.late == 0;
        let mut alternatives = Vec::new();
        if alone {
            self.moves(&mut alternatives);
        }
        // If a tick is the only enabled transition before and after it, the state between the two ticks is skipped.
        let quiet = alone && alternatives.len() == 1;
        for _ in 0..u8::MAX {
            let log = self.log.len();
            let kept = std::mem::replace(&mut self.keep_log, true);
            let result = self.one_tick(code);
            self.keep_log = kept;
            let happened = self.log.len() > log;
            if !kept {
                self.log.truncate(log);
            }
            result?;
            if !quiet || happened || self.is_over() {
                break;
            }
            let mut next = Vec::new();
            self.moves(&mut next);
            if next != [Move::Tick(0)] {
                break;
            }
        }
        Ok(())
    }

    /// Whether the passing of time alone changes nothing in this state any more.
    fn is_over(&self) -> bool {
        let waits = |node: &Node| node.time_left().is_some();
        self.in_flight.is_empty()
            && !self.nodes.iter().any(|s| s.up && waits(&s.node))
            && self
                .bodies
                .iter()
                .all(|b| b.activations.iter().all(|l| !matches!(l.does, Does::Works | Does::Serves)))
            && self.bodies.iter().all(|b| b.actor.as_ref().is_none_or(|actor| actor.running.is_empty()))
    }

    fn one_tick(&mut self, code: u16) -> Result<(), Violation> {
        self.passed += 1;
        self.used.fill(0);
        for carried in &mut self.in_flight {
            carried.age += Ticks(1);
        }
        self.spec_states.tick();
        for task in 0..self.bodies.len() {
            if self.nodes[self.node_state_of(task)].up {
                self.bodies[task].tick(&self.plan.tasks[task]);
            }
        }
        for i in 0..self.nodes.len() {
            if !self.nodes[i].up {
                continue;
            }
            let ticks = match (code >> (2 * i)) & 3 {
                LEFT_OUT => 0,
                TWICE => 2,
                LATER => {
                    self.faults.late -= 1;
                    self.nodes[i].owed += 1;
                    continue;
                }
                _ => 1,
            };
            if ticks != 1 {
                self.faults.drift -= 1;
            }
            self.pass(i, Ticks(ticks))?;
        }
        self.judge_waits()
    }

    /// Lets time pass for a node, including ticks that the node has not noticed yet.
    pub(crate) fn pass(&mut self, i: usize, ticks: Ticks) -> Result<(), Violation> {
        let owed = std::mem::take(&mut self.nodes[i].owed);
        let ticks = ticks + Ticks(u64::from(owed));
        if let Some(history) = &mut self.history {
            history.begin(i, ticks, &NodeInput::Time);
        }
        if self.orders { self.let_time_pass(i, ticks) } else { self.drive_on(i, ticks) }
    }

    pub(super) fn drive_on(&mut self, i: usize, ticks: Ticks) -> Result<(), Violation> {
        self.drive(i, |node, out| node.step(node.now() + ticks, NodeInput::Time, out))
    }

    pub(crate) fn crash(&mut self, i: usize) {
        self.spec_states.heard &= !(1 << i);
        let node_state = &mut self.nodes[i];
        node_state.up = false;
        (node_state.owed, node_state.asleep) = (0, None);
        let next = |task: &CommTask| (task.task(), task.next_sequence());
        let sequences: Vec<_> = node_state.node.parts().tasks.iter().map(next).collect();
        for (task, next) in sequences {
            self.sequences[task.index()] = next;
            let times = self.bodies[task.index()].times;
            self.bodies[task.index()] = Body { times, ..Body::new(&self.plan.tasks[task.index()]) };
            if matches!(self.plan.tasks[task.index()].errand, Errand::Receive { .. }) {
                self.bodies[task.index()].times = Body::ENDLESS;
            }
        }
    }

    pub(crate) fn restart(&mut self, i: usize) -> Result<(), Violation> {
        let node_state = &mut self.nodes[i];
        node_state.restart(self.plan.transit);
        // Ids of different incarnations are never compared: the new incarnation may continue with the numbers of the old
        // one.
        let mut from = From { rounds: &self.rounds, sequences: &self.sequences };
        for task in &mut node_state.node.parts_mut().tasks {
            task.walk(&node_state.table, &mut from);
        }
        self.set_clock(i);
        if let Some(history) = &mut self.history {
            history.forget(&self.nodes[i]);
        }
        // The checker of cells holds scripts back after a restart, as nodes do (D94).
        if self.turns.is_some() { Ok(()) } else { self.begin_all(i) }
    }

    /// Begins the tasks of a node.
    pub(crate) fn begin_all(&mut self, i: usize) -> Result<(), Violation> {
        let here = |task: &usize| self.node_state_of(*task) == i;
        let tasks: Vec<usize> = (0..self.bodies.len()).filter(here).collect();
        tasks.into_iter().try_for_each(|task| self.begin(task))
    }
}

/// A pass over the fields of a node that starts for the first time, which moves its epochs to the plan's first epoch.
pub(super) struct Epochs(pub u8);

impl Walk for Epochs {
    const PASS: Pass = Pass::Change;

    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        *epoch = epoch.wrapping_add(self.0);
    }
}

/// A pass over the fields of a new node, which moves its ids to the numbers from which this cell state counts.
struct From<'a> {
    rounds: &'a [Round],
    sequences: &'a [Seq24],
}

impl Walk for From<'_> {
    const PASS: Pass = Pass::Change;

    fn round(&mut self, port: PortId, round: &mut Round) {
        *round = round.plus(self.rounds[port.index()].0);
    }
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        *sequence = self.sequences[source.index()];
    }
}
