//! Shows the path to a finding as a monitor sees nodes: the state and the observations of every node after each step.

use super::parts::{only, parts};
use super::plan::{CellFaults, CellPlan};
use super::run_state::RunState;
use super::story::{self, Walked};
use super::verdict::{Finding, Phase, Step, TaskView};
use super::view::view;
use crate::cell_state::script::ScriptReaction;
use crate::cell_state::{Effect, NodeState};
use crate::chart::{Note, label};
use imrs_protocol::script::{Activity, Address, End};
use imrs_protocol::{Event, Incarnation, NodeId, Observation, Reason, TaskId};
use imrs_wire::obs::{Gathering, Liveness, Snapshot, TimerEntry};
use std::sync::Arc;

/// The greatest number of waiting messages that a snapshot lists for one port.
const QUEUE_LIMIT: usize = 64;

/// A node after a step of the path.
#[derive(Clone, Debug)]
pub struct NodeFrame {
    /// The node's incarnation.
    pub incarnation: Incarnation,
    /// The node's state; `None` while the node is down.
    pub snapshot: Option<Snapshot>,
    /// Observations of the step, each at a task, or at the transit buffer (`None`).
    pub observed: Vec<(Option<TaskId>, Observation)>,
}

/// Something that happened in a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Shows {
    /// A text about the step.
    Said(String),
    /// A task began the statement at this operation of its program.
    Began(TaskId, Address),
}

/// A step of the path to a finding.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Ticks since the start of the path.
    pub tick: u64,
    /// Whether the step stands out: it is the last one, or it has a fault, a packet that does not simply arrive, or a
    /// script that ends badly.
    pub odd: bool,
    /// What happened in the step, in order.
    pub happened: Vec<Shows>,
    /// The state of each task after the step, by position of the task.
    pub tasks: Vec<TaskView>,
    /// The state of each node after the step, by position of the node.
    pub nodes: Vec<NodeFrame>,
}

/// The path to a finding of `plan`: the scene before the first step, then the scene after each step. Empty for a finding
/// without moves.
#[must_use]
pub fn scenes(plan: &Arc<CellPlan>, finding: &Finding) -> Vec<Scene> {
    let plan = &super::outside::with_programs(plan);
    let plan = &plan.timed(finding.times);
    let part = finding.part.and_then(|number| parts(plan).into_iter().nth(number));
    let plan = &only(plan, part.as_ref());
    let faults = match finding.phase {
        Phase::FaultFree => CellFaults::default(),
        Phase::Faults => plan.faults.get(finding.hypothesis).cloned().unwrap_or_default(),
    };
    let mut dropped = vec![[0; Reason::ALL.len()]; plan.table.cell().nodes.len()];
    let start = RunState::new(plan, &faults);
    let mut scenes = vec![Scene {
        tick: 0,
        odd: false,
        happened: std::iter::once(Shows::Said("the start".into()))
            .chain(began(start.cell.turns.as_deref().unwrap_or_default()))
            .collect(),
        tasks: (0..plan.tasks.len()).map(|task| view(&start, task)).collect(),
        nodes: nodes(&start, &[], &dropped),
    }];
    if finding.moves.is_empty() {
        return Vec::new();
    }
    let mut last = 0;
    story::walk(plan, &faults, &finding.moves, |walked| {
        let Step { tick, tasks, notes, .. } = walked.step();
        let log = &walked.run_state.cell.log;
        for effect in log {
            if let Effect::Seen(node, _, Observation { event: Event::Discarded(reason), .. }) = effect {
                dropped[usize::from(*node)][*reason as usize] += 1;
            }
        }
        let happened = happenings(walked, tick - last);
        last = tick;
        scenes.push(Scene {
            tick,
            odd: walked.step.is_fault()
                || notes.iter().any(went_wrong)
                || walked.turns.iter().any(ended_badly),
            happened,
            tasks,
            nodes: nodes(walked.run_state, log, &dropped),
        });
    });
    if let Some(found) = scenes.last_mut() {
        found.odd = true;
    }
    scenes
}

fn began(turns: &[ScriptReaction]) -> impl Iterator<Item = Shows> {
    turns.iter().flat_map(|turn| {
        let task = TaskId::from_index(turn.task);
        turn.passed.iter().map(move |&at| Shows::Began(task, at))
    })
}

fn nodes(run_state: &RunState, log: &[Effect], dropped: &[[u64; Reason::ALL.len()]]) -> Vec<NodeFrame> {
    let frame = |(i, node_state): (usize, &NodeState)| {
        let here = |effect: &Effect| match *effect {
            Effect::Seen(node, task, observation) if usize::from(node) == i => Some((task, observation)),
            Effect::Seen(..) | Effect::Sent(..) | Effect::Signalled(..) => None,
        };
        NodeFrame {
            incarnation: node_state.incarnation,
            snapshot: (node_state.up || !run_state.plan.has_node(i))
                .then(|| snapshot(run_state, i, dropped[i])),
            observed: log.iter().filter_map(here).collect(),
        }
    };
    run_state.cell.nodes.iter().enumerate().map(frame).collect()
}

/// The snapshot of a node. Its clocks stay at zero: the caller knows the time of the model.
fn snapshot(run_state: &RunState, node: usize, dropped: [u64; Reason::ALL.len()]) -> Snapshot {
    let node_state = &run_state.cell.nodes[node];
    let parts = node_state.node.parts();
    let mut gathering = Gathering::new(dropped);
    for (task, machine) in node_state.table.tasks_on(NodeId::from_index(node)).zip(&parts.tasks) {
        let liveness = match run_state.activity(task.index()) {
            Some(Activity::Ended(End::Finished | End::Aborted(_) | End::Fenced)) => Liveness::Ended,
            Some(Activity::Ended(End::Assertion(_) | End::Fault { .. })) => Liveness::Crashed,
            Some(
                Activity::NotBegun
                | Activity::Waits
                | Activity::Acts
                | Activity::Chooses(_)
                | Activity::Passive,
            )
            | None => Liveness::Alive,
        };
        gathering.task(liveness, 0, machine.view(&node_state.table, QUEUE_LIMIT), &[]);
    }
    let entry = |(owner, id, remaining)| TimerEntry { owner, id, remaining };
    // The log of the step already counts the packets that the transit buffer drops.
    let mut transit = parts.transit.view();
    transit.discarded.clear();
    let timers = parts.timer.entries().into_iter().map(entry).collect();
    Snapshot { timers, ..gathering.snapshot(transit) }
}

/// What happened in a step, in order: the inputs, the statements that began, the scripts that ended, and the packets that
/// left nodes.
fn happenings(walked: &Walked<'_>, passed: u64) -> Vec<Shows> {
    let (came, ended) = walked.notes.split_at(walked.notes.len() - walked.ended);
    let words = |note: &Note| note.words(&walked.lanes.names);
    let later = (passed > 0).then(|| format!("{passed} tick{} later", if passed == 1 { "" } else { "s" }));
    let came = later.into_iter().chain(came.iter().map(words));
    let nodes = &walked.run_state.plan.table.cell().nodes;
    let left = walked.run_state.cell.log.iter().filter_map(|effect| match effect {
        Effect::Sent(next, packet) => {
            let next = nodes.get(next.index()).map_or("?", |node| node.name.as_str());
            let source = walked.lanes.names.get(packet.source.index()).map_or("?", String::as_str);
            Some(format!("{} of {source} leaves for {next}", label(packet, walked.ports)))
        }
        Effect::Signalled(..) | Effect::Seen(..) => None,
    });
    let ended = ended.iter().map(words);
    let said = Shows::Said;
    came.map(said).chain(began(walked.turns)).chain(ended.chain(left).map(said)).collect()
}

/// Whether a note shows something wrong: a packet whose outcome is not a plain arrival.
fn went_wrong(note: &Note) -> bool {
    matches!(note, Note::Packet { outcome, .. } if !outcome.is_empty())
}

fn ended_badly(turn: &ScriptReaction) -> bool {
    match &turn.end {
        Some(End::Aborted(_) | End::Assertion(_) | End::Fault { .. }) => true,
        Some(End::Finished | End::Fenced) | None => false,
    }
}
