//! Predicates of checks about a whole cell, evaluated on the communication tasks and on specification state (D45).

use super::CellState;
use super::plan::CellScenario;
use imrs_protocol::script::{Activity, Predicate, Reading, Term};
use imrs_protocol::{CommTask, PortId, Request, Round, TaskId};

/// The specification state of predicates. It is empty if no check asks for predicates.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct PredicateState {
    /// For each member of a waitfor that checks name: whether the member has reached the waitfor in this incarnation. If
    /// the member's node is down: whether the member had arrived when the node crashed.
    pub reached: Vec<(PortId, TaskId, bool)>,
    /// Whether the last request of the task on the port was answered.
    pub answered: Vec<(TaskId, PortId, bool)>,
}

impl PredicateState {
    pub fn new(plan: &CellScenario) -> Self {
        let mut told = Self::default();
        for predicate in plan.predicates() {
            match predicate {
                Predicate::Arrived { port, .. } if told.reached.iter().all(|&(known, ..)| known != port) => {
                    let parties = plan.cell.port(port).map_or(&[][..], |port| &port.parties);
                    told.reached.extend(parties.iter().map(|party| (port, party.task, false)));
                }
                Predicate::Answered { task, port } if !told.answered.contains(&(task, port, false)) => {
                    told.answered.push((task, port, false));
                }
                Predicate::Arrived { .. }
                | Predicate::Answered { .. }
                | Predicate::Asked { .. }
                | Predicate::Active(_) => {}
            }
        }
        told
    }

    /// All flags of the predicates, in the order of the packed state.
    pub fn flags_mut(&mut self) -> impl Iterator<Item = &mut bool> {
        let reached = self.reached.iter_mut().map(|(.., flag)| flag);
        reached.chain(self.answered.iter_mut().map(|(.., flag)| flag))
    }

    /// Records that the task's request on this port has ended.
    pub fn ended(&mut self, task: TaskId, port: Option<PortId>, answered: bool) {
        let of = self.answered.iter_mut().filter(|(whose, at, _)| *whose == task && Some(*at) == port);
        of.for_each(|(.., flag)| *flag = answered);
    }
}

impl CellState {
    /// Records an API call of a task, if checks ask about such a call.
    pub(super) fn note_asked(&mut self, task: TaskId, request: &Request) {
        match *request {
            Request::Arrive { port, .. } => {
                let nodes = &self.nodes;
                let up = |member: TaskId| {
                    self.plan.cell.location(member).is_some_and(|node| nodes[node.index()].up)
                };
                for (at, member, flag) in &mut self.spec_states.told.reached {
                    if *at == port && *member == task {
                        *flag = true;
                    } else if *at == port && !up(*member) {
                        *flag = false;
                    }
                }
            }
            Request::Send { port, .. } => self.spec_states.told.ended(task, Some(port), false),
            _ => {}
        }
    }

    /// Records a crash: keeps at which waitfors the node's tasks had arrived, and drops their answers. Call it while the
    /// node is up.
    pub(crate) fn note_crash(&mut self, node: usize) {
        let arrived: Vec<bool> = self
            .spec_states
            .told
            .reached
            .iter()
            .map(|&(port, task, _)| self.has_arrived(port, task))
            .collect();
        let on_node = |cell_state: &Self, task: TaskId| cell_state.node_state_of(task.index()) == node;
        for (i, arrived) in arrived.into_iter().enumerate() {
            if on_node(self, self.spec_states.told.reached[i].1) {
                self.spec_states.told.reached[i].2 = arrived;
            }
        }
        for i in 0..self.spec_states.told.answered.len() {
            if on_node(self, self.spec_states.told.answered[i].0) {
                self.spec_states.told.answered[i].2 = false;
            }
        }
    }

    /// Records a restart: the node's tasks have not arrived at any waitfor.
    pub(crate) fn note_restart(&mut self, node: usize) {
        for i in 0..self.spec_states.told.reached.len() {
            if self.node_state_of(self.spec_states.told.reached[i].1.index()) == node {
                self.spec_states.told.reached[i].2 = false;
            }
        }
    }

    pub(crate) fn look_up(&self, term: Term) -> Option<i64> {
        match term.reads()? {
            Reading::Variable(task, variable) => {
                self.bodies.get(task.index())?.actor.as_ref()?.host.script.var(variable)
            }
            Reading::Predicate(predicate) => self.holds(predicate).map(i64::from),
        }
    }

    fn holds(&self, predicate: Predicate) -> Option<bool> {
        Some(match predicate {
            Predicate::Active(task) => {
                let is_alive = self.bodies.get(task.index())?.actor.as_ref().is_none_or(|actor| {
                    let activity = actor.host.script.activity();
                    !matches!(activity, Activity::NotBegun | Activity::Passive | Activity::Ended(_))
                });
                is_alive && self.is_active(task)
            }
            Predicate::Asked { task, port } => {
                self.bodies.get(task.index())?;
                self.machine(task).is_some_and(|machine| machine.outstanding().any(|(p, ..)| p == port))
            }
            Predicate::Answered { task, port } => {
                let answered = &self.spec_states.told.answered;
                answered.iter().find(|&&(whose, at, _)| (whose, at) == (task, port))?.2
            }
            Predicate::Arrived { port, task } => {
                self.plan.cell.port(port)?.party(task)?;
                self.has_arrived(port, task)
            }
        })
    }

    /// Whether the task reached the waitfor and no member has begun a later meeting at this waitfor since.
    fn has_arrived(&self, port: PortId, task: TaskId) -> bool {
        let reached = self.spec_states.told.reached.iter().filter(|&&(at, _, flag)| at == port && flag);
        let rounds: Vec<(TaskId, Option<Round>)> = reached
            .map(|&(_, member, _)| (member, self.machine(member).and_then(|machine| machine.announced(port))))
            .collect();
        let newest = rounds.iter().filter_map(|&(_, round)| round).reduce(Round::fresher);
        // If the node of a task is down, only the flag counts.
        rounds.iter().any(|&(member, round)| member == task && (round.is_none() || round == newest))
    }

    /// Whether a task is active: its node is up, and the task has its lease if it needs one. While a node is paused, a
    /// task's lease still ends on time, unnoticed by the task: the robot's driver stops the action then (D149).
    pub(crate) fn is_active(&self, task: TaskId) -> bool {
        let Some(node_state) = self.nodes.get(self.node_state_of(task.index())) else { return false };
        // The time that the communication task has not noticed yet: the time of a pause, or of this tick if that is still a
        // queued input.
        let unnoticed = u64::from(node_state.asleep.unwrap_or(0)) + node_state.node.late(task).0;
        self.machine(task).is_some_and(|machine| {
            machine.is_active() && machine.lease_left().is_none_or(|left| left.0 > unnoticed)
        })
    }

    /// The communication task of a task whose node is up.
    fn machine(&self, task: TaskId) -> Option<&CommTask> {
        let node_state = self.nodes.get(self.plan.cell.location(task)?.index())?;
        if node_state.up { node_state.node.task(task) } else { None }
    }
}
